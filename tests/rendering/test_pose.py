"""The pose of a placed lamp: changed in a loaded scene, and derivatives of images by it."""

import dataclasses

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.geometry import MeshShape
from lumitree.asset.light_field import make_light_field
from lumitree.core.frames import LocalFrame, similarity
from lumitree.core.octahedral import middle_directions
from lumitree.errors import LumitreeError
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.light_fields import random_light_field
from support.slow import slow, slow_but_sets

POSE, GAIN = "lamp.emitter.to_world", "lamp.emitter.gain"
FRAME = LocalFrame(np.array([0.9, 1.0, 0.7]), similarity(np.eye(3), 1.3, [0.1, 0.2, 0.0]))
RESOLUTION = 16


def smooth_lamp(*, absolute=False):
    """An asset whose light varies slowly with the direction, and differs from cell to cell."""
    cells = np.stack(np.meshgrid(*3 * [np.arange(4)], indexing="ij"), axis=-1).reshape(-1, 3)
    towards = middle_directions(RESOLUTION)
    down = (1.2 - towards[:, 1] + 0.4 * towards[:, 0]) ** 2
    brightness = 1 + 0.3 * cells[:, 0] + 0.1 * cells[:, 1]
    intensity = brightness[:, None, None] * down[:, None] * np.array([1.0, 0.8, 0.5])
    field = make_light_field(cells, intensity, 2, absolute=absolute)
    return light_field_asset(field, FRAME, "smooth")


def lamps():
    """Assets with the parts light field; field; light field and field; and geometry, too."""
    frame = LocalFrame(np.ones(3), np.eye(4))
    return {
        "light": smooth_lamp(),
        "field": random_asset(1),
        "both": dataclasses.replace(random_asset(1), light_field=random_light_field(2)),
        "geometry": with_geometry(small_geometry(), frame),
    }


def scene_with(mi, bsdf=None, **shapes):
    """Lamps above a floor, of which a camera sees a part to one side."""
    place = mi.ScalarTransform4f
    film = {"type": "hdrfilm", "width": 12, "height": 12, "rfilter": {"type": "box"}}
    look = place().look_at([1.2, 2.5, 3], [0.9, -1.5, 0.5], [0, 1, 0])
    floor = place().translate([0, -1.5, 0]).rotate([1, 0, 0], -90).scale(6)
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "fov": 30, "to_world": look, "film": film},
            "floor": {
                "type": "rectangle",
                "to_world": floor,
                "bsdf": bsdf or {"type": "diffuse"},
            },
            **shapes,
        }
    )


def image(mi, scene, kind="lumitree_path", spp=16, seed=1):
    integrator = mi.load_dict({"type": kind, "max_depth": 4})
    return np.array(mi.render(scene, integrator=integrator, spp=spp, seed=seed), np.float64)


def moved_to(mi, x=0.0, y=0.0, z=0.0, angle=0.0, scale=1.0):
    """A transform of numbers, or of arrays of Dr.Jit."""
    turned = (
        mi.Transform4f().translate(mi.Vector3f(x, y, z)).rotate(mi.Vector3f(0.6, 0, 0.8), angle)
    )
    return turned.scale(mi.Float(scale))


@pytest.mark.parametrize(
    ("name", "kind"),
    slow_but_sets(
        [("geometry", "lumitree_path"), ("light", "lumitree_path")],
        ("geometry", "light", "both", "field"),
        ("lumitree_path", "prb"),
    ),
)
def test_a_moved_lamp_is_as_one_that_is_loaded_there(mi, name, kind):
    """Light, geometry and proxy; also into the floor, which it then lights inside its box."""
    asset, appearance = lamps()[name], "field" if kind == "prb" else None
    options = {"appearance": appearance, "gain": 3}
    scene = scene_with(mi, lamp=lumitree.shape(asset, np.eye(4), **options))
    parameters, before = mi.traverse(scene), image(mi, scene, kind)
    assert before.mean() > 0.01
    for pose in (
        moved_to(mi, 0.8, -0.2, 0.5, 30, 0.5),
        moved_to(mi, 0.8, -1.3, 0.5, 30, 0.5),
        moved_to(mi),
    ):
        parameters[POSE] = pose
        parameters.update()
        matrix = np.array(pose.matrix, np.float64).reshape(4, 4)
        expected = image(mi, scene_with(mi, lamp=lumitree.shape(asset, matrix, **options)), kind)
        found = image(mi, scene, kind)
        assert np.median(np.abs(found - expected)) < 1e-5 * expected.mean()
        # Rounding gives a few samples another bin of direction, on which their light depends.
        assert (np.abs(found - expected) > 1e-4 * expected.mean()).mean() < 0.04
    assert (np.abs(found - before) > 1e-4 * before.mean()).mean() < 0.04


def test_parameters_of_lamps_are_what_they_follow(mi):
    scene = scene_with(mi, lamp=lumitree.shape(lamps()["geometry"]))
    names = [name for name in mi.traverse(scene).keys() if name.startswith("lamp")]  # noqa: SIM118
    of_geometry = [name for name in names if not name.startswith("lamp.")]
    assert set(names) - set(of_geometry) == {"lamp.emitter.sampling_weight", GAIN, POSE}
    assert any(".bsdf." in name for name in of_geometry)
    arrays = ("vertex", "faces", "emitter")
    assert not any(each in name for name in of_geometry for each in arrays)


def test_glass_of_two_lamps_of_one_asset_stays_apart(mi):
    """Mitsuba would merge meshes of one BSDF, which then belong to no lamp."""
    shapes = (
        MeshShape(material=0, vertices=4, faces=4, normals=True, texcoords=True, colours=True),
        MeshShape(material=2, vertices=4, faces=4),
    )
    asset = with_geometry(small_geometry(shapes=shapes), LocalFrame(np.ones(3), np.eye(4)))
    away = similarity(np.eye(3), 1.0, [3, 0, 0])
    scene = scene_with(mi, lamp=lumitree.shape(asset), other=lumitree.shape(asset, away))
    glass = {"lamp_geometry_1", "other_geometry_1"}
    assert glass <= {shape.id() for shape in scene.shapes()}


@pytest.mark.parametrize(
    "pose", [np.diag([1, 2, 1, 1]), np.diag([-1, 1, 1, 1]), np.full((4, 4), np.nan)]
)
def test_a_bad_pose_is_refused_and_the_lamp_stays(mi, pose):
    scene = scene_with(mi, lamp=lumitree.shape(lamps()["light"]))
    parameters = mi.traverse(scene)
    parameters[POSE] = mi.Transform4f(pose)
    with pytest.raises(LumitreeError, match="to_world"):
        parameters.update()
    assert np.array(mi.traverse(scene)[POSE].matrix)[..., 0] == pytest.approx(np.eye(4))


def test_derivatives_need_a_light_field(mi):
    import drjit as dr

    parameters = mi.traverse(scene_with(mi, lamp=lumitree.shape(lamps()["field"])))
    dr.enable_grad(parameters[POSE])
    parameters.set_dirty(POSE)
    with pytest.raises(LumitreeError, match="no light field; bake it again"):
        parameters.update()


BASE = {"x": 0.1, "y": 0.7, "z": -0.2, "angle": 20.0, "scale": 0.35, "gain": 3.0}
STEPS = {"x": 0.04, "y": 0.04, "z": 0.04, "angle": 2.0, "scale": 0.02, "gain": 0.3}
BSDFS = {
    "diffuse": {"type": "diffuse"},
    "glossy": {"type": "roughplastic", "alpha": 0.2},
}


def set_lamp(mi, parameters, gain, **pose):
    parameters[POSE] = moved_to(mi, **pose)
    parameters[GAIN] = mi.Color3f(gain)
    parameters.update()


def scene_of(mi, asset, bsdf="diffuse", others=0, sampling="emission"):
    """One lamp whose pose is changed, and others."""
    place = mi.ScalarTransform4f
    shapes = {
        f"lamp{i or ''}": lumitree.shape(
            asset, place().translate([-0.8 * i, 0.6, -0.5 * i]).scale(0.3), sampling
        )
        for i in range(others + 1)
    }
    return scene_with(mi, BSDFS[bsdf], **shapes)


COLOURS = [1.0, 0.8, 0.5]


def differences(mi, scene, integrator, spp):
    """Central differences of the mean of an image, with equal seeds."""
    parameters = mi.traverse(scene)

    def mean(values):
        set_lamp(mi, parameters, **values)
        pixels = np.array(mi.render(scene, integrator=integrator, spp=spp, seed=2), np.float64)
        return pixels.mean(axis=(0, 1)) @ COLOURS

    return {
        key: (mean(BASE | {key: BASE[key] + step}) - mean(BASE | {key: BASE[key] - step}))
        / (2 * step)
        for key, step in STEPS.items()
    }


def gradient(mi, scene, integrator, spp, seed):
    import drjit as dr

    parameters = mi.traverse(scene)
    values = {key: mi.Float(value) for key, value in BASE.items()}
    dr.enable_grad(*values.values())
    set_lamp(mi, parameters, **values)
    pixels = mi.render(scene, parameters, integrator=integrator, spp=1, spp_grad=spp, seed=seed)
    dr.backward(dr.mean(pixels, axis=(0, 1)).array * COLOURS)
    return {key: float(dr.grad(value)[0]) for key, value in values.items()}


@pytest.mark.parametrize(
    ("bsdf", "others", "spp"),
    [
        ("diffuse", 0, 1024),
        slow("diffuse", 1, 4096),
        slow("glossy", 0, 8192),
        slow("glossy", 1, 8192),
    ],
)
def test_gradients_are_central_differences(mi, bsdf, others, spp):
    import drjit as dr

    scene = scene_of(mi, smooth_lamp(), bsdf, others)
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 3})
    expected = differences(mi, scene, integrator, spp)
    assert gradient(mi, scene, integrator, spp, 7) == pytest.approx(expected, rel=0.03)
    # In forward mode, too.
    parameters, x = mi.traverse(scene), mi.Float(BASE["x"])
    dr.enable_grad(x)
    set_lamp(mi, parameters, **BASE | {"x": x})
    dr.forward(x, dr.ADFlag.ClearEdges)
    pixels = mi.render(scene, parameters, integrator=integrator, spp=1, spp_grad=spp, seed=7)
    forward = np.array(dr.forward_to(pixels)).mean(axis=(0, 1)) @ COLOURS
    assert forward == pytest.approx(expected["x"], rel=0.03)


@pytest.mark.slow
def test_gradients_of_absolute_intensities(mi):
    """Their radiance falls with the area of the lamp."""
    scene = scene_of(mi, smooth_lamp(absolute=True))
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 3})
    expected = differences(mi, scene, integrator, 2048)
    assert gradient(mi, scene, integrator, 2048, 7) == pytest.approx(expected, rel=0.03)


@pytest.mark.slow
def test_gradients_of_prb_agree(mi):
    """Within their noise, which is larger."""
    scene = scene_of(mi, smooth_lamp(), sampling="uniform")
    path, prb = (mi.load_dict({"type": kind, "max_depth": 3}) for kind in ("lumitree_path", "prb"))
    expected = gradient(mi, scene, path, 4096, 5)
    found = [gradient(mi, scene, prb, 4096, seed) for seed in range(8)]
    for key, value in expected.items():
        sample = np.array([each[key] for each in found])
        error = sample.std(ddof=1) / np.sqrt(len(sample))
        assert abs(sample.mean() - value) < 0.03 * abs(value) + 4 * error, key
        assert error < 0.15 * abs(value), key
