"""Sampling of surfaces that emit, against closed forms and rays that hit them by chance."""

import numpy as np
import pytest

import lumitree
from lumitree.core.mitsuba_meshes import make_mesh
from lumitree.lamp.emitting_surfaces import emitting_surfaces
from lumitree.lamp.luminaire import load_luminaire
from support.camera_flux import flux_by_camera_paths
from support.lamps import AREA, scene, sphere

# Upper left quarter white, as seen: row 0 is the top.
QUARTER = np.zeros((16, 16, 3), np.float32)
QUARTER[:8, :8] = 1


def quads(mi, path, *corners_and_uv):
    """A PLY file of quads [4, 3] with texture coordinates [4, 2], as an emitter's shape."""
    points = np.concatenate([points for points, _ in corners_and_uv])
    uv = np.concatenate([uv for _, uv in corners_and_uv])
    faces = np.concatenate(
        [np.array([[0, 1, 2], [0, 2, 3]]) + 4 * i for i in range(len(corners_and_uv))]
    )
    mesh = make_mesh("quads", {"vertices": points, "faces": faces, "texcoords": uv})
    mesh.write_ply(str(path))
    return {"type": "ply", "filename": str(path), "face_normals": True}


def quad(centre, side=1.0):
    """Corners of a square that faces up (z)."""
    unit = np.array([[-1, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]]) / 2
    return np.array(centre) + side * unit


UNIT = np.array([[0, 0], [1, 0], [1, 1], [0, 1]])
WHITE = np.full((4, 2), 0.25)  # All corners at one white texel


def bare_watts(lamp, count=1 << 17):
    from lumitree.trace.light_paths import LampRays

    return LampRays(lamp).bare_flux(count, 1) * lamp.frame.scale**2


def test_points_are_uniform_by_area_and_have_the_interaction_of_a_ray(mi):
    import drjit as dr

    area = {"type": "area", "radiance": {"type": "rgb", "value": [3, 2, 1]}}
    described = {"type": "scene"}
    for number, kind in enumerate(("sphere", "cylinder", "disk", "rectangle", "cube")):
        place = mi.ScalarTransform4f().translate([4 * number, 0, 0]).scale(0.5 + 0.1 * number)
        described[kind] = {"type": kind, "emitter": area, "to_world": place}
    whole = mi.load_dict(described)
    surfaces = emitting_surfaces(whole)
    areas = [float(np.ravel(each.get_shape().surface_area())[0]) for each in whole.emitters()]
    assert surfaces.power == pytest.approx(2 * sum(areas), rel=1e-5)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, 1 << 16)
    point = surfaces.sample(sampler.next_2d())
    # Equal radiance: all points have the same density.
    assert np.array(point.density) == pytest.approx(1 / sum(areas), rel=1e-5)
    number = np.bincount(np.array(point.index), minlength=5)
    expected = np.array(areas) / sum(areas) * (1 << 16)
    assert ((number - expected) ** 2 / expected).sum() < 25  # χ² of 4 degrees, p < 1e-4
    si = point.si
    hit = whole.ray_intersect(mi.Ray3f(si.p + 0.01 * si.n, -si.n))
    # Two of 65,536 may be at an edge.
    same = np.array((hit.shape == si.shape) & (hit.prim_index == si.prim_index))
    assert same.mean() > 0.999
    assert np.abs(np.array(hit.uv - si.uv))[:, same].max() < 1e-4
    assert np.array(dr.abs(hit.p - si.p)).max() < 1e-4


# Texture coordinates, and the part of a unit square that is white with them.
PLACED = {
    "once": (UNIT, 0.25),
    "tiled": (3 * UNIT, 0.25),
    "mirrored": (UNIT * [-1, 1], 0.25),
    "one texel": (WHITE, 1.0),
    "a line": (UNIT * [1, 0] + [0, 0.25], 0.5),
}


@pytest.mark.parametrize("name", PLACED)
def test_flux_is_that_of_the_surface_not_of_the_image(mi, tmp_path, name):
    uv, part = PLACED[name]
    watts = bare_watts(load_luminaire(image_lamp(mi, tmp_path, (quad([0, 0, 0]), uv))))
    # A part p of n paths carries light: a relative error of sqrt((1 - p) / p / n).
    assert watts == pytest.approx(np.pi * part, rel=4 * np.sqrt((1 - part) / part / 2**17) + 1e-5)


def image_lamp(mi, tmp_path, *corners_and_uv, transform=None):
    mi.Bitmap(QUARTER).write(str(tmp_path / "quarter.exr"))
    radiance = {
        "type": "bitmap",
        "filename": str(tmp_path / "quarter.exr"),
        "raw": True,
        "filter_type": "nearest",
    }
    if transform is not None:
        radiance["to_uv"] = transform
    shape = quads(mi, tmp_path / "quads.ply", *corners_and_uv)
    return {**shape, "emitter": {"type": "area", "radiance": radiance}}


def test_faces_that_share_coordinates_emit_each(mi, tmp_path):
    """Three bulbs on one patch of an atlas, and a dark part."""
    patches = [(quad([2 * i, 0, 0]), UNIT) for i in range(3)]
    dark = (quad([0, 3, 0]), UNIT / 2 + 0.5)
    lamp = load_luminaire(image_lamp(mi, tmp_path, *patches, dark))
    assert bare_watts(lamp) == pytest.approx(3 * np.pi / 4, rel=0.02)
    seen = flux_by_camera_paths(lamp, 1 << 20)
    assert (np.abs(seen.watts - bare_watts(lamp)) < 4 * np.array(seen.watts_error)).all()


def test_a_transform_of_coordinates_moves_the_light(mi, tmp_path):
    half = mi.ScalarTransform4f().scale([0.5, 0.5, 1])
    lamp = load_luminaire(image_lamp(mi, tmp_path, (quad([0, 0, 0]), UNIT), transform=half))
    assert bare_watts(lamp) == pytest.approx(np.pi, rel=1e-4)


def test_a_textured_cylinder_and_sphere(mi, tmp_path):
    mi.Bitmap(QUARTER).write(str(tmp_path / "q.exr"))
    radiance = {"type": "bitmap", "filename": str(tmp_path / "q.exr"), "raw": True}
    for kind, part in (("cylinder", 0.25), ("sphere", 0.25)):
        emitter = {"type": "area", "radiance": {**radiance, "filter_type": "nearest"}}
        lamp = load_luminaire({"type": kind, "emitter": emitter})
        area = float(np.ravel(lamp.scene.shapes()[0].surface_area())[0])
        # u is the azimuth; v the height, or the polar angle: half the sphere is at v < 0.5.
        assert bare_watts(lamp) == pytest.approx(np.pi * area * part, rel=0.03)


def test_a_weight_of_0_does_not_take_away_light(mi, tmp_path):
    weightless = AREA.replace(
        'type="area">', 'type="area"><float name="sampling_weight" value="0"/>'
    )
    path = tmp_path / "lamp.xml"
    shapes = sphere("a", 1, inside=AREA), sphere("b", 1, (3, 0, 0), inside=weightless)
    path.write_text(scene(*shapes))
    lamp = load_luminaire(path)
    assert bare_watts(lamp) == pytest.approx(8 * np.pi**2 * np.array([3, 2, 1]), rel=1e-4)
    assert [each.sampling_weight() for each in lamp.scene.emitters()] == [1, 1]


def irradiance(mi, lamps, integrator, spp, seed=0):
    """Mean radiance of a white floor below lamps, and its standard error, by passes."""
    floor = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 0, -1]).scale(2),
        "bsdf": {"type": "diffuse", "reflectance": 1.0},
    }
    room = lumitree_scene(
        {
            "type": "scene",
            "floor": floor,
            **lamps,
            "sensor": {
                "type": "perspective",
                "fov": 60,
                "to_world": mi.ScalarTransform4f().look_at([0, 0.1, -0.5], [0, 0, -1], [0, 1, 0]),
                "film": {"type": "hdrfilm", "width": 8, "height": 8, "rfilter": {"type": "box"}},
            },
            "integrator": {"type": integrator, "max_depth": 2},
        }
    )
    passes = [np.array(mi.render(room, spp=spp, seed=seed + i)).mean() for i in range(16)]
    return np.mean(passes), np.std(passes, ddof=1) / 4


def lumitree_scene(described):
    """A scene as `render` loads it."""
    from lumitree.rendering.scene import load_without_camera

    return load_without_camera(described)[0]


def patches(mi, tmp_path):
    """Faces on one patch of an image, which face down."""
    down = np.array([1.0, -1.0, -1.0])
    corners = [(quad([x, 0, 0]) * down, UNIT) for x in (-1, 0.2, 1.4)]
    return image_lamp(mi, tmp_path, *corners)


def bent_normals(mi, tmp_path):
    """A face whose shading normals lean outwards by 75 degrees."""
    lamp = image_lamp(mi, tmp_path, (quad([0, 0, 0]), UNIT))
    points = quad([0, 0, 0]) * [1, -1, -1]
    normals = points / np.sqrt(0.5) + [0, 0, -np.tan(np.radians(15))]
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    arrays = {"vertices": points, "faces": [[0, 1, 2], [0, 2, 3]], "normals": normals}
    make_mesh("bent", arrays | {"texcoords": UNIT}).write_ply(lamp["filename"])
    return lamp | {"face_normals": False}


@pytest.mark.parametrize("integrator", ["path", "lumitree_path", "ptracer"])
@pytest.mark.parametrize("make", [patches, bent_normals])
def test_emitter_sampling_finds_what_rays_find_by_chance(mi, tmp_path, make, integrator):
    """`prb_basic` samples no emitters."""
    lamp = {"lamp": make(mi, tmp_path)}
    lumitree.register()
    chance, error = irradiance(mi, lamp, "prb_basic", 2048)
    found, other = irradiance(mi, lamp, integrator, 256)
    assert other < 0.02 * found
    assert abs(found - chance) < 4 * np.hypot(error, other)
