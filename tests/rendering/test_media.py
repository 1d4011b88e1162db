"""Media under `lumitree_path`: against Beer's law, a furnace, and Mitsuba's `volpathmis`."""

import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.media import absorption, any_scatters, media
from support.equal_means import assert_equal_means
from support.fields import uniform_asset
from support.lamps import GLASS, cube
from support.lamps import scene as scene_xml
from support.slow import slow

SIDE, PASSES = 8, 16
ABSORPTION = np.array([0.5, 1.0, 0.25])
RADIANCE = np.array([5.0, 4.0, 3.0])


def rgb(values):
    return {"type": "rgb", "value": list(values)}


def medium(factor=1.0, albedo=(0.0, 0.0, 0.0), phase=None):
    """A medium with this many times the extinction `ABSORPTION`."""
    extinction = {"sigma_t": rgb(ABSORPTION), "scale": factor, "albedo": rgb(albedo)}
    return {"type": "homogeneous", **extinction, "phase": phase or {"type": "isotropic"}}


def block(bsdf, thickness=1.0, **members):
    """A block around the origin, thick along z."""
    import mitsuba as mi

    to_world = mi.ScalarTransform4f().scale([3, 3, thickness / 2])
    return {"type": "cube", "to_world": to_world, "bsdf": {"type": bsdf}, **members}


def lit_wall(**objects):
    """A wall that emits and fills the image, and what is before it."""
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at([0, 0, 5], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}}
    return {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 1, "to_world": look, "film": film},
        "wall": {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f().translate([0, 0, -2]).scale(3),
            "bsdf": {"type": "diffuse", "reflectance": 0.0},
            "emitter": {"type": "area", "radiance": rgb(RADIANCE)},
        },
        **objects,
    }


def image(mi, description, integrator="lumitree_path", spp=16, seed=0, **options):
    loaded = mi.load_dict(description)
    made = mi.load_dict({"type": integrator, "max_depth": 16, "rr_depth": 100, **options})
    return np.array(mi.render(loaded, integrator=made, spp=spp, seed=seed))[..., :3]


def test_a_block_attenuates_by_its_thickness(mi):
    """Beer's law, without noise: nothing but the way in the medium changes the radiance."""
    inside = block("null", 1.5, interior=medium())
    pixels = image(mi, lit_wall(block=inside))
    expected = RADIANCE * np.exp(-1.5 * ABSORPTION)
    np.testing.assert_allclose(pixels, np.broadcast_to(expected, pixels.shape), rtol=3e-4)


def test_media_follow_each_other(mi):
    """A block in a block, as its interior and its exterior say."""
    inner = block("null", 0.4, interior=medium(3.0), exterior=medium())
    pixels = image(mi, lit_wall(outer=block("null", 1.0, interior=medium()), inner=inner))
    expected = RADIANCE * np.exp(-(0.6 + 3 * 0.4) * ABSORPTION)
    np.testing.assert_allclose(pixels, np.broadcast_to(expected, pixels.shape), rtol=3e-4)


@pytest.mark.parametrize("hide", [False, True])
def test_a_camera_in_a_medium(mi, hide):
    """All ways are attenuated, those to the background and past hidden emitters, too."""
    description = lit_wall(light={"type": "constant", "radiance": rgb(RADIANCE)})
    description["sensor"] |= {"medium": medium(0.1), "near_clip": 1e-4}
    pixels = image(mi, description, hide_emitters=hide)
    # Behind a hidden wall the way has no end.
    expected = np.zeros(3) if hide else RADIANCE * np.exp(-0.7 * ABSORPTION)
    np.testing.assert_allclose(pixels, np.broadcast_to(expected, pixels.shape), rtol=3e-4)


def passes(mi, description, integrator, seed, spp, **options):
    """Means [PASSES, 3] of independent images."""
    return np.array(
        [
            image(mi, description, integrator, spp, seed + index, **options).mean(axis=(0, 1))
            for index in range(PASSES)
        ]
    )


def lit_floor(*blocks):
    """A floor under a window, with blocks between them; the camera sees the floor alone."""
    import mitsuba as mi

    look = mi.ScalarTransform4f().look_at([2.4, 0.7, 0], [0, 0, 0], [0, 1, 0])
    film = {"type": "hdrfilm", "width": SIDE, "height": SIDE, "rfilter": {"type": "box"}}
    up = mi.ScalarTransform4f().rotate([1, 0, 0], -90)
    down = mi.ScalarTransform4f().translate([0, 2, 0]).rotate([1, 0, 0], 90)
    return {
        "type": "scene",
        "sensor": {"type": "perspective", "fov": 20, "to_world": look, "film": film},
        "floor": {"type": "rectangle", "to_world": up.scale(3), "bsdf": {"type": "diffuse"}},
        "window": {
            "type": "rectangle",
            "to_world": down.scale(0.4),
            "emitter": {"type": "area", "radiance": rgb(RADIANCE)},
        },
        **{f"block_{index}": each for index, each in enumerate(blocks)},
    }


@pytest.mark.parametrize("bsdf", ["null", slow("dielectric"), slow("roughdielectric")])
def test_shadow_rays_and_paths_cross_media(mi, bsdf):
    """Through clear borders by next-event estimation, through glass by paths: as `volpathmis`."""
    to_world = mi.ScalarTransform4f().translate([0, 1.1, 0]).rotate([0, 0, 1], 10)
    slab = block(bsdf, interior=medium())
    slab["to_world"] = to_world.scale([1, 0.25, 1])
    description = lit_floor(slab)
    if bsdf != "null":
        # Paths find it: next-event estimation cannot pass glass.
        description["window"]["to_world"] = description["window"]["to_world"].scale(3)
    spp = 256
    ours = passes(mi, description, "lumitree_path", 0, spp)
    theirs = passes(mi, description, "volpathmis", 500, spp)
    clear = passes(mi, lit_floor(), "lumitree_path", 900, 16)
    assert_equal_means(ours, theirs)
    assert (ours.std(0) < 0.05 * ours.mean(0)).all()
    assert bsdf != "null" or (ours.mean(0) < 0.95 * clear.mean(0)).all()


MILK = (0.9, 0.5, 0.7)
FORWARDS = {"type": "hg", "g": 0.6}


def foggy(factor, **options):
    """All of a scene is in a medium that scatters."""
    description = lit_floor()
    description["sensor"]["medium"] = medium(factor, MILK, **options)
    return description


def milk(bsdf):
    """A ball of milk over the floor, in the light from all sides."""
    ball = {"type": "sphere", "center": [0, 0.5, 0], "radius": 0.4, "bsdf": {"type": bsdf}}
    description = lit_floor(ball | {"interior": medium(4.0, MILK, FORWARDS)})
    light = {"light": {"type": "constant", "radiance": rgb(RADIANCE)}}
    return {name: each for name, each in description.items() if name != "window"} | light


def lamp_in_fog():
    """A lamp and its field in a medium, over the floor."""
    import mitsuba as mi

    import lumitree

    lamp = lumitree.shape(
        uniform_asset(2.0, (5, 3, 2), law="exponential"), np.diag([0.3] * 3 + [1])
    )
    description = foggy(0.3)
    del description["window"]
    lower = mi.ScalarTransform4f().translate([0, -0.6, 0])
    description["floor"]["to_world"] = lower @ description["floor"]["to_world"]
    return description | {"lamp": lamp}


SCATTERING = {
    "fog": lambda: foggy(0.5),
    "forward fog": lambda: foggy(0.5, phase=FORWARDS),
    "milk": lambda: milk("null"),
    "opal glass": lambda: milk("dielectric"),
    "frosted glass": lambda: milk("roughdielectric"),
    "lamp in fog": lamp_in_fog,
}


# A hidden lamp is not in the image at all, while `volpathmis` hides its light alone.
@pytest.mark.slow
@pytest.mark.parametrize(
    ("name", "hide"),
    [
        ("fog", True),
        ("opal glass", False),
        *(slow(name, False) for name in SCATTERING if name != "opal glass"),
        slow("milk", True),
        slow("opal glass", True),
    ],
)
def test_media_that_scatter(mi, name, hide):
    """Means of all channels agree with `volpathmis`, also where emitters are hidden."""
    description, options = SCATTERING[name](), {"hide_emitters": hide, "max_depth": 64}
    ours = passes(mi, description, "lumitree_path", 0, 128, **options)
    theirs = passes(mi, description, "volpathmis", 500, 128, **options)
    assert_equal_means(ours, theirs)
    assert (ours.std(0) < 0.2 * ours.mean(0)).all()


@pytest.mark.parametrize("bsdf", ["null", "dielectric"])
def test_milk_that_absorbs_nothing_disappears_in_a_furnace(mi, bsdf):
    """In light that is the same from all sides."""
    ball = {"type": "sphere", "bsdf": {"type": bsdf}, "interior": medium(2.0, (1, 1, 1), FORWARDS)}
    description = lit_wall(ball=ball, light={"type": "constant", "radiance": rgb(RADIANCE)})
    del description["wall"]
    pixels = image(mi, description, spp=1024, max_depth=1000, rr_depth=1000)
    error = pixels.reshape(-1, 3).std(0) / SIDE
    assert (np.abs(pixels.mean(axis=(0, 1)) - RADIANCE) < 5 * error + 1e-3 * RADIANCE).all()
    assert (error < 0.01 * RADIANCE).all()


def test_heterogeneous_media_are_refused(mi):
    grid = {"type": "gridvolume", "grid": mi.VolumeGrid(np.full((2, 2, 2, 1), 0.5, np.float32))}
    uneven = {"type": "heterogeneous", "sigma_t": grid, "albedo": 0.0}
    loaded = mi.load_dict(lit_wall(block=block("null", interior=uneven)))
    with pytest.raises(LumitreeError, match=r"a medium is heterogeneous; .*: use volpath"):
        mi.load_dict({"type": "lumitree_path"}).render(loaded, spp=1)


def test_what_a_luminaire_tells_of_its_media(mi, tmp_path):
    glass = (
        '{}<medium type="homogeneous" name="interior"><float name="scale" value="2"/>'
        '<rgb name="sigma_t" value="0.25,0.5,1"/><rgb name="albedo" value="{}"/></medium>'
    )
    light = '<emitter type="area"/>'
    found = {}
    for albedo in ("0,0,0", "0,0.1,0"):
        block_of_glass = cube("block", 0.3, (2, 0, 0), glass.format(GLASS, albedo))
        path = tmp_path / "lamp.xml"
        path.write_text(scene_xml(cube("bulb", 0.2, inside=light), block_of_glass))
        lamp = load_luminaire(path)
        assert lamp.has_media
        assert lamp.scatters == any_scatters(lamp.scene)
        found[albedo] = [absorption(each) for each in media(lamp.scene)], lamp.scatters
    ((absorbed,), scatters), ((none,), also) = found.values()
    np.testing.assert_allclose(absorbed, [0.5, 1, 2], rtol=1e-5)
    assert (scatters, none, also) == (False, None, True)
