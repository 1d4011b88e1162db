"""The geometry of an asset in images: against the explicit lamp, and what it must not change."""

from typing import Any

import numpy as np
import pytest
from scipy import stats

import lumitree
from lumitree.core.frames import rotation, similarity
from lumitree.rendering.scene import place_shapes
from support.explicit_lamps import baked_once
from support.lamps import GLASS, cube, scene, sphere
from support.slow import slow, slow_but

SIDE, PASSES = 16, 16
BLACK = '<bsdf type="diffuse"><rgb name="reflectance" value="0,0,0"/></bsdf>'
GLOWS = f'{BLACK}<emitter type="area"><rgb name="radiance" value="6,5,3"/></emitter>'
GREY = '<bsdf type="diffuse"><rgb name="reflectance" value="0.5,0.5,0.5"/></bsdf>'
MIRROR = '<bsdf type="conductor"><string name="material" value="Ag"/></bsdf>'
# A filament in a thick glass bulb beside a mirror: every camera path is specular.
SPECULAR = scene(
    sphere("filament", 0.25, inside=GLOWS),
    sphere("bulb", 0.8, inside=GLASS),
    sphere("hollow", 0.6, inside=GLASS, flip=True),
    cube("mirror", (0.05, 0.6, 0.6), (1.1, 0, 0), MIRROR),
)
# A bare light with something that hides a part of it and fills a corner of the box.
SHADED = scene(
    sphere("filament", 0.5, inside=GLOWS),
    cube("shade", (1.0, 0.02, 0.3), (0, -0.8, 0.4), GREY),
)
PLACE = similarity(rotation([0, 1, 1], 20), 0.4, [0, 1, 0])


@pytest.fixture(scope="module")
def make(mi, tmp_path_factory):
    return baked_once(tmp_path_factory.mktemp("lamps"), paths=1 << 20)


@pytest.fixture(scope="module")
def specular(make):
    return make(SPECULAR)


@pytest.fixture(scope="module")
def shaded(make):
    return make(SHADED)


def baked(asset, appearance: Any = "geometry", place=PLACE, **options):
    return {"lamp": lumitree.shape(asset, place, appearance=appearance, **options)}


def explicit(lamp, place=PLACE):
    return place_shapes(lamp, place)


def camera(origin, target, fov=40, up=(0, 1, 0)):
    import mitsuba as mi

    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}}
    look = mi.ScalarTransform4f().look_at(origin, target, up)
    return {"type": "perspective", "fov": fov, "to_world": look, "film": film, "near_clip": 1e-4}


def panel(origin, target, scale, radiance):
    """An area light that reflects nothing."""
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at(origin, target, [0, 1, 0.01]).scale(scale)
    return {
        "type": "rectangle",
        "to_world": look,
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}},
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
    }


def floor(bsdf):
    import mitsuba as mi

    to_world = mi.ScalarTransform4f().rotate([1, 0, 0], -90).scale(2)
    return {"type": "rectangle", "to_world": to_world, "bsdf": bsdf}


def passes(objects, integrator="lumitree_path", spp=1024, seed=0, **options):
    """[PASSES, H, W, 3] independent images."""
    import mitsuba as mi

    loaded = mi.load_dict({"type": "scene", **objects})
    made = mi.load_dict({"type": integrator, **options})
    return np.array(
        [
            np.array(mi.render(loaded, integrator=made, spp=spp // PASSES, seed=seed + i))
            for i in range(PASSES)
        ]
    )


def assert_same_expectation(first, second):
    """z-test in every pixel, and of the whole image; rounding is not a difference."""
    first, second = first.astype(np.float64), second.astype(np.float64)

    def p_values(ours, theirs):
        difference = np.abs(ours.mean(0) - theirs.mean(0))
        rounding = 1e-5 + 1e-4 * theirs.mean(0)
        error = np.sqrt((ours.var(0, ddof=1) + theirs.var(0, ddof=1)) / PASSES + rounding**2)
        return 2 * stats.t.sf(difference / error, 2 * PASSES - 2)

    pixels = p_values(first, second)
    assert pixels.min() > 1e-3 / pixels.size
    # A bias too small to show in one pixel shows here.
    assert p_values(first.mean(axis=(1, 2)), second.mean(axis=(1, 2))).min() > 1e-4


def mirror_and_ball():
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at([-1.2, 1, -0.4], [0, 1, 0], [0, 1, 0]).scale(0.5)
    return {
        "mirror": {"type": "rectangle", "to_world": look, "bsdf": {"type": "conductor"}},
        "ball": {
            "type": "sphere",
            "center": [0.35, 0.8, 0.8],
            "radius": 0.25,
            "bsdf": {"type": "dielectric"},
        },
    }


VIEWS = {
    "outside": ([0.3, 1.2, 1.9], [0, 1, 0], 45),
    "through a mirror": ([0.6, 1.1, 1.5], [-1.2, 1, -0.4], 40),
    "inside the bulb": ([0.05, 1.13, 0.12], [0.1, 1.0, -1], 90),
    "inside the box": ([-0.36, 1.25, 0.25], [0.3, 1, -1], 90),
}


DEEP: dict[str, Any] = {"max_depth": 24, "rr_depth": 24}


def before_a_panel(name, **objects):
    """Objects of a view besides the lamp."""
    origin, target, fov = VIEWS[name]
    back = panel([0.2, 1, -2], [0, 1, 0], 1.6, [0.6, 0.9, 1.4])
    return {"sensor": camera(origin, target, fov), "back": back, **objects}


@pytest.mark.parametrize("name", slow_but(["inside the bulb"], VIEWS))
def test_specular_paths_see_the_lamp_as_it_is(specular, name):
    """Glass, mirrors and the filament look as in images of the explicit lamp."""
    lamp, asset = specular
    objects = before_a_panel(name, **mirror_and_ball())
    ours = passes(objects | baked(asset), **DEEP)
    theirs = passes(objects | explicit(lamp), "path", seed=500, **DEEP)
    assert_same_expectation(ours, theirs)
    assert ours.mean() > 0.1


TINTED = GLASS + (
    '<medium type="homogeneous" name="interior"><rgb name="sigma_t" value="0.2,0.5,1"/>'
    '<float name="scale" value="8"/><float name="albedo" value="0"/></medium>'
)


@pytest.mark.slow
def test_tinted_glass_is_seen_as_it_is(make):
    """Media of the geometry absorb by the size of the lamp, at any place and scale."""
    lamp, asset = make(SPECULAR.replace(GLASS, TINTED, 1))
    assert asset.geometry.has_media
    objects = before_a_panel("outside")
    ours = passes(objects | baked(asset), **DEEP)
    theirs = passes(objects | explicit(lamp), "volpathmis", seed=500, **DEEP)
    assert_same_expectation(ours, theirs)
    clear = passes(objects | baked(make(SPECULAR)[1]), **DEEP)
    assert ours[..., 2].mean() < 0.9 * clear[..., 2].mean()


@pytest.mark.slow
def test_other_lights_are_tinted_by_glass(make):
    """The floor under a tinted pane: that under a clear one, attenuated by the way of the light."""
    objects = {
        "sensor": camera([0, 0.3, 1.2], [0, 0, 0.1], 8),
        "floor": floor({"type": "diffuse"}),
        "window": panel([0, 3, 0], [0, 0, 0], 0.1, [600, 500, 400]),
    }
    # Close to the floor below it and wide, so that all light crosses it nearly perpendicularly.
    place = similarity(np.eye(3), 0.8, [0, 0.6, 0])
    options: dict[str, Any] = {"max_depth": 2}
    pane = PANE.replace('y="0.001"', 'y="0.05"')
    assert pane != PANE
    clear = passes(objects | baked(make(pane)[1], place=place), **options)
    tinted = passes(objects | baked(make(pane.replace(GLASS, TINTED))[1], place=place), **options)
    found = tinted.mean(axis=(0, 1, 2)) / clear.mean(axis=(0, 1, 2))
    # The pane is 0.1 high in the unit of the file, of which the place scales the half side to 0.8.
    np.testing.assert_allclose(found, np.exp(-8 * 0.1 * np.array([0.2, 0.5, 1])), rtol=0.01)


@pytest.mark.slow
def test_surfaces_that_lie_in_the_faces_of_the_box_are_met(make):
    lamp, asset = make(scene(cube("box", 0.5, inside=GLOWS)))
    objects = {
        "sensor": camera([0.3, 1.5, 1.9], [0, 1, 0], 40),
        "back": panel([0, 1, -2], [0, 1, 0], 2, [0.2, 0.3, 0.5]),
    }
    for place in (PLACE, similarity(np.eye(3), 0.4, [0, 1, 0])):
        ours = passes(objects | baked(asset, place=place), spp=256)
        theirs = passes(objects | explicit(lamp, place), "path", spp=256, seed=500)
        assert_same_expectation(ours, theirs)


def assert_direct_light_is_the_field(asset, below, **sensor):
    """A floor gets the same with the geometry as with the field: nothing is added by the shapes."""
    objects = {"sensor": camera([0.9, 1.2, 2.4], [0.4, 0, 1.2], 25) | sensor, "floor": below}
    ours = passes(objects | baked(asset), spp=2048, max_depth=2)
    field = passes(objects | baked(asset, "field"), spp=2048, seed=500, max_depth=2)
    assert ours.mean() > 1e-3
    assert_same_expectation(ours, field)
    return ours


@pytest.mark.parametrize(
    "bsdf",
    [
        slow({"type": "diffuse"}),
        {"type": "roughconductor", "alpha": 0.15},
        slow({"type": "roughplastic", "alpha": 0.1}),
    ],
)
def test_direct_light_is_the_light_field_once(specular, bsdf):
    assert_direct_light_is_the_field(specular[1], floor(bsdf))


@pytest.mark.slow
def test_direct_light_is_that_of_the_explicit_lamp(shaded):
    """The mean of the floor, within its noise and 1 % for the cells of the light field."""
    lamp, asset = shaded
    objects = {"sensor": camera([0, 3, 0.01], [0, 0, 0], 40), "floor": floor({"type": "diffuse"})}
    objects["lid"] = {**floor({"type": "diffuse"}), "to_world": hidden_lid()}
    ours = passes(objects | baked(asset), spp=1024, max_depth=2).mean(axis=(1, 2))
    theirs = passes(objects | explicit(lamp), "path", spp=1024, seed=500, max_depth=2)
    theirs = theirs.mean(axis=(1, 2))
    error = np.hypot(ours.std(0), theirs.std(0)) / np.sqrt(PASSES)
    allowed = 5 * error + 0.01 * theirs.mean(0)
    assert (np.abs(ours.mean(0) - theirs.mean(0)) < allowed).all()


def hidden_lid():
    """Keeps the camera from seeing the lamp, without a shadow on the floor."""
    import mitsuba as mi

    return mi.ScalarTransform4f().translate([0, 1.6, 0]).rotate([1, 0, 0], 90).scale(0.5)


DIM = f'{GREY}<emitter type="area"><rgb name="radiance" value="1e-4,1e-4,1e-4"/></emitter>'
ROUGH = '<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>'
# Two lights of unequal radiance, one of them flat, before surfaces of several kinds.
LIT = scene(
    sphere("filament", 0.3, inside=GLOWS),
    cube("strip", (0.02, 0.3, 0.1), (0.9, 0, 0), DIM.replace("1e-4", "4")),
    cube("shade", (1.0, 0.04, 0.6), (0, 0.7, 0), GREY),
    cube("arm", (0.6, 0.05, 0.4), (-0.2, -0.7, 0), ROUGH),
)
DARK = scene(
    sphere("filament", 0.1, inside=DIM),
    cube("shade", (0.8, 0.04, 0.4), (0.1, 0.3, 0), GREY),
    cube("arm", (0.1, 0.5, 0.1), (0.3, -0.2, 0.2), ROUGH),
)


def lit_room():
    """A floor and an area light above it, both in the image, with the lamp between them."""
    return {
        "sensor": camera([0.8, 1.5, 2.4], [0, 0.6, 0], 50),
        "floor": floor({"type": "diffuse"}),
        "window": panel([-0.3, 2.4, 0.5], [0, 0, 0], 0.5, [6, 5, 4]),
    }


@pytest.mark.slow
def test_a_lamp_that_is_nearly_dark_is_an_object_of_the_room(make):
    """It reflects the light of others, is reflected, and its opaque parts cast true shadows."""
    lamp, asset = make(DARK)
    options: dict[str, Any] = {"max_depth": 8}
    ours = passes(lit_room() | baked(asset), spp=2048, **options)
    theirs = passes(lit_room() | explicit(lamp), "path", spp=2048, seed=500, **options)
    assert_same_expectation(ours, theirs)


# A pane of which both faces are parallel, and what it is if it has no thickness.
PANE = scene(
    sphere("filament", 0.02, inside=DIM), cube("pane", (0.9, 0.001, 0.9), (0, 0, 0), GLASS)
)
SHEET = {"type": "thindielectric", "int_ior": 1.5, "ext_ior": 1.0}


@pytest.mark.slow
def test_other_lights_pass_glass_with_its_fresnel_transmittance(make):
    """The floor under a pane is that under a sheet of thin glass, which is exact there."""
    import mitsuba as mi

    _, asset = make(PANE)
    place = similarity(np.eye(3), 0.8, [0, 1, 0])
    objects = {
        "sensor": camera([0, 0.6, 1.8], [0, 0, 0.2], 40),
        "floor": floor({"type": "diffuse"}),
        "window": panel([-0.4, 2.4, 0.4], [0, 0, 0], 0.6, [6, 5, 4]),
    }
    sheet = {
        "type": "rectangle",
        "to_world": mi.ScalarTransform4f().translate([0, 1, 0]).rotate([1, 0, 0], 90).scale(0.72),
        "bsdf": SHEET,
    }
    options: dict[str, Any] = {"max_depth": 6, "rr_depth": 100}
    ours = passes(objects | baked(asset, place=place), spp=2048, **options)
    sheet = passes(objects | {"sheet": sheet}, spp=2048, seed=500, **options)
    open_ = passes(objects, spp=2048, seed=900, **options)
    assert_same_expectation(ours, sheet)
    # The pane takes light away: the test can fail.
    assert ours.mean() < 0.97 * open_.mean()


@pytest.mark.slow
@pytest.mark.parametrize("place_at", [2.0, slow(1.0)], ids=["beside", "above"])
def test_the_light_of_another_lamp_is_blocked_by_opaque_parts_alone(make, shaded, place_at):
    """Two geometries: as one with the shapes of the other as objects of the room."""
    dark, dark_asset = make(DARK)
    _, asset = shaded
    above = similarity(np.eye(3), 0.3, [0, place_at, 0])
    below = similarity(np.eye(3), 0.4, [0.0, 0.5, 0.0])
    objects = {
        "sensor": camera([0.6, 0.9, 2.4], [0.2, 0, 0.6], 40),
        "floor": floor({"type": "diffuse"}),
    }
    other = {"other": lumitree.shape(asset, above, appearance="geometry")}
    options: dict[str, Any] = {"max_depth": 4}
    ours = passes(objects | other | baked(dark_asset, place=below), spp=2048, **options)
    theirs = passes(objects | other | explicit(dark, below), spp=2048, seed=500, **options)
    assert_same_expectation(ours, theirs)


@pytest.mark.slow
def test_a_receiver_that_touches_the_box_gets_its_light_once(make):
    """Within the margin between box and proxy, emitter sampling alone finds the light field."""
    import mitsuba as mi

    # Light that crosses thick glass is in the light field, and nothing in the box blocks it.
    bulb = sphere("bulb", 0.5, inside=GLASS) + sphere("hollow", 0.45, inside=GLASS, flip=True)
    shade = cube("shade", (1.0, 0.02, 0.3), (0, -0.8, 0.4), GREY)
    _, asset = make(scene(sphere("filament", 0.3, inside=GLOWS), bulb, shade))
    place = similarity(np.eye(3), 0.4, [0, 0, 0])
    half = asset.frame.half_extents[1] * asset.frame.scale * 0.4
    for gap in (-1e-4, 0.0, 2e-5, 1e-2):
        to_world = (
            mi.ScalarTransform4f().translate([0, half + gap, 0]).rotate([1, 0, 0], 90).scale(2)
        )
        ceiling = {"type": "rectangle", "to_world": to_world, "bsdf": {"type": "diffuse"}}
        sensor = camera([0.9, -0.4, 0.1], [0.9, half, 0], 70, up=(1, 0, 0))
        objects = {"sensor": sensor, "ceiling": ceiling}
        options: dict[str, Any] = {"max_depth": 2}
        ours = passes(objects | baked(asset, place=place), spp=2048, **options)
        field = passes(objects | baked(asset, "field", place), spp=2048, seed=500, **options)
        assert_same_expectation(ours, field)


@pytest.mark.slow
@pytest.mark.parametrize("rr_depth", [2, slow(24)])
def test_rough_surfaces_of_the_lamp_show_its_own_light(make, rr_depth):
    """Next-event estimation and paths that hit the filament, weighted against each other."""
    lamp, asset = make(LIT)
    objects = {"sensor": camera([0.2, 0.3, 1.6], [0, 1, 0], 45)}
    options: dict[str, Any] = {"max_depth": 6, "rr_depth": rr_depth}
    ours = passes(objects | baked(asset), spp=2048, **options)
    theirs = passes(objects | explicit(lamp), "path", spp=2048, seed=500, **options)
    assert_same_expectation(ours, theirs)


@pytest.mark.slow
def test_rough_surfaces_of_the_lamp_get_its_light_through_its_glass(make):
    """The table under a pane gets what it gets under thin glass."""
    pane = cube("pane", (0.9, 0.001, 0.9), inside=GLASS)
    sheet = (
        '<shape type="rectangle" id="pane"><transform name="to_world"><rotate x="1" angle="90"/>'
        '<scale value="0.9"/></transform><bsdf type="thindielectric"><float name="int_ior" '
        'value="1.5"/><float name="ext_ior" value="1"/></bsdf></shape>'
    )
    place = similarity(np.eye(3), 0.4, [0, 1, 0])
    images = []
    for between in (pane, sheet):
        table = cube("table", (0.9, 0.02, 0.9), (0, -0.5, 0), GREY)
        _, asset = make(scene(sphere("filament", 0.1, (0, 0.5, 0), GLOWS), between, table))
        objects = {"sensor": camera([0.1, 0.98, 0.3], [0.1, 0.81, 0], 30)}
        images.append(passes(objects | baked(asset, place=place), max_depth=8))
    assert images[0].mean() > 0.01
    assert_same_expectation(*images)


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["sphere", "cube"])
def test_rough_surfaces_show_the_light_of_textures(mi, make, tmp_path, kind):
    """On a sphere, and on a cube, all faces of which have the same texture coordinates.

    `prb_basic` finds emitters only by hitting them.
    """
    pixels = np.full((8, 8, 3), 3, np.float32)
    pixels[:3, :3] = 30, 20, 10
    mi.Bitmap(pixels).write(str(tmp_path / "patch.exr"))
    texture = (
        f'{BLACK}<emitter type="area"><texture type="bitmap" name="radiance">'
        f'<string name="filename" value="{tmp_path}/patch.exr"/><boolean name="raw" value="true"/>'
        '<string name="filter_type" value="nearest"/></texture></emitter>'
    )
    glowing = (sphere if kind == "sphere" else cube)("glow", 0.4, inside=texture)
    table = cube("table", (1.2, 0.05, 1.2), (0, -0.8, 0), GREY)
    lamp, asset = make(scene(glowing, table))
    objects = {"sensor": camera([0.2, 1.6, 1.6], [0, 0.8, 0], 45)}
    ours = passes(objects | baked(asset), spp=4096, max_depth=2)
    theirs = passes(objects | explicit(lamp), "prb_basic", spp=1 << 14, seed=500, max_depth=2)
    assert_same_expectation(ours, theirs)


@pytest.mark.slow
def test_a_surface_gets_the_own_light_of_its_lamp_alone(make, shaded):
    """The light of another lamp comes from its light field."""
    _, asset = shaded
    dark, dark_asset = make(DARK)
    above, below = (similarity(np.eye(3), 0.3, [0, y, 0]) for y in (1.6, 0.9))
    objects = {"sensor": camera([0, 1.2, 1.6], [0, 0.95, 0], 25)}
    objects["other"] = lumitree.shape(asset, above, appearance="geometry")
    options: dict[str, Any] = {"max_depth": 3}
    ours = passes(objects | baked(dark_asset, place=below), spp=2048, **options)
    theirs = passes(objects | explicit(dark, below), spp=2048, seed=500, **options)
    assert ours.mean() > 1e-3
    assert_same_expectation(ours, theirs)


@pytest.mark.slow
def test_light_paths_start_at_the_box_of_a_lamp_with_geometry(shaded):
    """Particle tracing compiles the emitters of the geometry's shapes too, which start none."""
    _, asset = shaded
    view = camera([1.3, 0.6, 0], [1.1, 0, 0], 20)
    room = {"sensor": view, "floor": floor({"type": "diffuse"})}
    images = [
        passes(
            {**room, **baked(asset, appearance)}, kind, samples, max_depth=3, hide_emitters=True
        ).mean()
        # Few light paths meet what the camera sees: the error of the first mean is 3 %.
        for appearance, kind, samples in (
            ("geometry", "ptracer", 1 << 14),
            ("field", "lumitree_path", 1 << 10),
        )
    ]
    assert images[1] > 0.01
    # The geometry's shapes stand in the way of some of the light paths.
    assert 0.1 * images[1] < images[0] < 1.1 * images[1]


@pytest.mark.slow
def test_other_integrators_light_a_room_alike(shaded):
    """The room gets the light of the light field, whatever part the lamp shows."""
    _, asset = shaded
    view = camera([0, 1.2, 3], [0, 0, 0.0])
    below = {"floor": floor({"type": "diffuse"}), "sensor": view}
    images = [passes(below | baked(asset, each), "volpath", 256, max_depth=2)
              for each in ("field", "geometry")]  # fmt: skip
    # The lowest rows show the floor alone.
    field, geometry = (each[:, SIDE * 3 // 4 :].mean(axis=(1, 2, 3)) for each in images)
    error = np.hypot(field.std(ddof=1), geometry.std(ddof=1)) / np.sqrt(PASSES)
    assert field.mean() > 0
    assert error < 0.02 * field.mean()
    assert geometry.mean() == pytest.approx(field.mean(), abs=4 * error + 0.005 * field.mean())
