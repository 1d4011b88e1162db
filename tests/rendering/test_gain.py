"""The gain of a placed lamp: a factor on its light, in all methods of the emitter and in images."""

import dataclasses
import gc

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.core.frames import LocalFrame
from lumitree.errors import LumitreeError
from lumitree.rendering.placement import Placement
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry
from support.light_fields import random_light_field
from support.slow import slow_but_sets

GAIN = (0.5, 2.0, 3.0)
NAME = "lamp.emitter.gain"
ASSETS = ("field", "both", "light")


def lamps():
    """Assets with the parts field; light_field and field; light_field; geometry."""
    field = random_asset(1)
    light_field = random_light_field(2)
    return {
        "field": field,
        "both": dataclasses.replace(field, light_field=light_field),
        "light": light_field_asset(light_field, field.frame, "test"),
        "geometry": with_geometry(small_geometry(), LocalFrame(np.ones(3), np.eye(4))),
    }


@pytest.fixture(params=ASSETS)
def asset(request):
    return lamps()[request.param]


def scene_with(mi, asset, **options):
    """A lamp above a floor, and a camera that sees both."""
    look = mi.ScalarTransform4f().look_at([0, 2.5, 4], [0, -0.5, 0], [0, 1, 0])
    floor = mi.ScalarTransform4f().translate([0, -1.2, 0]).rotate([1, 0, 0], -90).scale(3)
    film = {"type": "hdrfilm", "width": 16, "height": 16, "rfilter": {"type": "box"}}
    return mi.load_dict(
        {
            "type": "scene",
            "sensor": {"type": "perspective", "fov": 50, "to_world": look, "film": film},
            "floor": {
                "type": "rectangle",
                "to_world": floor,
                "bsdf": {"type": "roughplastic", "alpha": 0.3},
            },
            "lamp": lumitree.shape(asset, **options),
        }
    )


def render(mi, scene, kind="lumitree_path", *, seed=1, spp=16, params=None, **options):
    integrator = mi.load_dict({"type": kind, "max_depth": 4})
    return mi.render(scene, params, integrator=integrator, spp=spp, seed=seed, **options)


@pytest.mark.parametrize(
    ("asset", "kind"),
    [
        ("geometry", "lumitree_path"),
        *slow_but_sets(
            [("light", "lumitree_path"), ("both", "path"), ("field", "volpath"), ("both", "prb")],
            ASSETS,
            ("lumitree_path", "path", "volpath", "prb"),
        ),
    ],
    indirect=["asset"],
)
def test_an_image_is_proportional_to_the_gain(mi, asset, kind):
    plain, gained = (
        np.array(render(mi, scene_with(mi, asset, gain=gain), kind)) for gain in (1, GAIN)
    )
    assert plain.mean() > 0.01
    assert gained == pytest.approx(plain * GAIN, rel=1e-4, abs=1e-5)


def test_light_paths_carry_the_gain(mi, asset):
    images = []
    for gain in (1, GAIN):
        scene = scene_with(mi, asset, gain=gain)
        integrator = mi.load_dict({"type": "ptracer", "max_depth": 3, "hide_emitters": True})
        images.append(np.array(mi.render(scene, integrator=integrator, spp=16, seed=3)))
    assert images[0].mean() > 0.01
    assert images[1] == pytest.approx(images[0] * GAIN, rel=1e-4, abs=1e-5)


def test_lamps_of_one_asset_have_gains_of_their_own(mi):
    import drjit as dr

    asset = lamps()["both"]
    away = np.eye(4)
    away[0, 3] = 5
    gains = {"near": (1, 0, 0), "far": (0, 1, 0)}
    shapes = {
        "near": lumitree.shape(asset, gain=gains["near"]),
        "far": lumitree.shape(asset, away, gain=gains["far"]),
    }
    scene = mi.load_dict({"type": "scene", **shapes})
    for offset, gain in ((0, gains["near"]), (5, gains["far"])):
        origin = mi.Point3f(dr.linspace(mi.Float, -0.9, 0.9, 32) + offset, 0.1, 3.0)
        si = scene.ray_intersect(mi.Ray3f(origin, mi.Vector3f(0, 0, -1)))
        light = np.array(si.emitter(scene).eval(si)).max(axis=1)
        assert ((light > 0) == np.array(gain, bool)).all()


@pytest.mark.parametrize("asset", [*ASSETS, "geometry"], indirect=True)
def test_another_gain_needs_no_reload_and_no_new_kernel(mi, asset):
    import drjit as dr

    # Emitters of scenes that are freed only after the first rendering would change its kernel.
    gc.collect()
    scene = scene_with(mi, asset)
    params = mi.traverse(scene)
    plain = np.array(render(mi, scene))
    with dr.scoped_set_flag(dr.JitFlag.KernelHistory):
        for gain in (GAIN, (0.0, 1.0, 7.0)):
            dr.kernel_history_clear()
            params[NAME] = mi.Color3f(*map(float, gain))
            params.update()
            image = np.array(render(mi, scene))
            # One of size 1 stores the numbers of the gain, which are a part of it.
            history = dr.kernel_history([dr.KernelType.JIT])
            kernels = [kernel for kernel in history if kernel["size"] > 1]
            assert kernels
            assert all(kernel["cache_hit"] for kernel in kernels)
            assert image == pytest.approx(plain * gain, rel=1e-4, abs=1e-5)


@pytest.mark.parametrize("appearance", ["field", "geometry"])
def test_only_parameters_that_a_lamp_follows_are_shown(mi, appearance):
    asset = with_geometry(small_geometry(), LocalFrame(np.ones(3), np.eye(4)))
    params = mi.traverse(mi.load_dict(lumitree.shape(asset, appearance="field")))
    names = ("gain", "to_world", "sampling_weight")
    assert set(params.keys()) == {f"emitter.{name}" for name in names}
    scene = scene_with(mi, asset, appearance=appearance)
    lamp = [key for key in mi.traverse(scene).keys() if key.startswith("lamp.")]  # noqa: SIM118
    assert lamp == ["lamp.emitter.sampling_weight", NAME, "lamp.emitter.to_world"]


def test_gradients_of_lamps_that_show_geometry_say_nothing(mi, capfd):
    """Dr.Jit warns of each loop that derivatives cannot make an evaluated one."""
    import drjit as dr

    asset = with_geometry(small_geometry(), LocalFrame(np.ones(3), np.eye(4)))
    scene = scene_with(mi, asset, appearance="geometry")
    params = mi.traverse(scene)
    dr.enable_grad(params[NAME])
    params.update()
    image = render(mi, scene, seed=5, params=params, seed_grad=1)
    dr.backward(dr.mean(image, axis=None))
    # An image is linear in the gain, which is 1, and there is no other light.
    expected = float(np.array(render(mi, scene_with(mi, asset, appearance="geometry"))).mean())
    assert float(np.sum(dr.grad(params[NAME]))) == pytest.approx(expected, rel=1e-3)
    assert "".join(capfd.readouterr()) == ""


@pytest.mark.parametrize(
    ("asset", "kind"),
    slow_but_sets([("field", "prb")], ASSETS, ("lumitree_path", "prb")),
    indirect=["asset"],
)
def test_the_gradient_is_that_of_finite_differences(mi, asset, kind):
    import drjit as dr

    scene = scene_with(mi, asset, gain=GAIN)
    params = mi.traverse(scene)
    dr.enable_grad(params[NAME])
    params.update()
    image = render(mi, scene, kind, seed=5, params=params, seed_grad=1)
    dr.backward(dr.mean(image, axis=(0, 1)).array * [1, 2, 3])
    gradient = np.array(dr.grad(params[NAME]), np.float64).ravel()
    differences = []
    # An image is linear in the gain, so a difference may be large.
    for channel, step in enumerate(np.diag([0.5, 0.5, 0.5])):
        ends = []
        for gain in (GAIN - step, GAIN + step):
            params[NAME] = mi.Color3f(*map(float, gain))
            params.update()
            image = np.array(render(mi, scene, kind), np.float64)
            ends.append((image.mean(axis=(0, 1)) * [1, 2, 3])[channel])
        differences.append(ends[1] - ends[0])
    assert gradient == pytest.approx(differences, rel=1e-3)
    assert min(differences) > 0.01


BAD = [-1, (1, 2), (1, 2, -3), "bright", float("nan"), None, (1, 2, float("inf")), 1e9, [[1, 2]]]


@pytest.mark.parametrize("gain", BAD)
def test_bad_gains_are_refused(mi, gain):
    with pytest.raises(LumitreeError, match=r"gain is .*; expected one number or three"):
        lumitree.shape(lamps()["field"], gain=gain)
    with pytest.raises(LumitreeError, match="gain is"):
        Placement("lamp.lumitree", gain=gain)


@pytest.mark.parametrize("gain", [(-1, 1, 1), (1, float("nan"), 1), (1, 1, 1e9)])
def test_a_bad_parameter_is_refused_and_the_gain_stays(mi, gain):
    scene = scene_with(mi, lamps()["field"], gain=GAIN)
    params = mi.traverse(scene)
    params[NAME] = mi.Color3f(*map(float, gain))
    with pytest.raises(LumitreeError, match="gain is"):
        params.update()
    assert np.array(mi.traverse(scene)[NAME]).ravel() == pytest.approx(GAIN)


def test_explicit_lamps_have_no_gain(mi):
    with pytest.raises(LumitreeError, match=r"lamp\.xml has a gain of 2.*; bake it first"):
        Placement("lamp.xml", gain=2)
    assert Placement("lamp.xml").gain == 1


@pytest.mark.parametrize(
    ("text", "gain"),
    [
        ('<rgb name="gain" value="0.5, 2, 3"/>', GAIN),
        ('<vector name="gain" x="0.5" y="2" z="3"/>', GAIN),
        ('<float name="gain" value="2.5"/>', (2.5, 2.5, 2.5)),
        ('<integer name="gain" value="3"/>', (3, 3, 3)),
        ("", (1, 1, 1)),
    ],
)
def test_a_scene_file_names_it(mi, tmp_path, text, gain):
    lumitree.save(lamps()["field"], tmp_path / "lamp.lumitree")
    file = '<string name="filename" value="lamp.lumitree"/>'
    (tmp_path / "scene.xml").write_text(
        '<scene version="3.0.0"><shape type="lumitree_proxy" id="lamp">'
        f"{file}{text}</shape></scene>"
    )
    scene = mi.load_file(str(tmp_path / "scene.xml"))
    assert np.array(scene.emitters()[0].lamp.gain).ravel() == pytest.approx(gain)


@pytest.mark.parametrize(
    "text", ['<rgb name="gain" value="-1, 2, 3"/>', '<string name="gain" value="red"/>']
)
def test_a_scene_file_with_a_bad_one_is_refused(mi, tmp_path, text):
    lumitree.save(lamps()["field"], tmp_path / "lamp.lumitree")
    file = '<string name="filename" value="lamp.lumitree"/>'
    (tmp_path / "scene.xml").write_text(
        f'<scene version="3.0.0"><shape type="lumitree_proxy">{file}{text}</shape></scene>'
    )
    with pytest.raises(Exception, match="gain is"):
        mi.load_file(str(tmp_path / "scene.xml"))
