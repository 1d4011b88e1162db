"""Small images of what was accepted: finite and not negative."""

import contextlib

import mitsuba as mi
import numpy as np

from lumitree.core.backend import load_mitsuba
from lumitree.core.frames import pose_towards
from lumitree.errors import LumitreeError, explained
from lumitree.formats import light_sources
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.stored_geometry import stored_geometry
from lumitree.rendering.asset_images import shown_images
from lumitree.rendering.register import register, shape
from support.variant import VARIANT

_PIXELS = 4


def assert_renders(asset):
    """An asset can be shown alone, and lights a wall."""
    load_mitsuba(VARIANT)
    register()
    pose = pose_towards((0.4, 0.25, 0.882), (0, 1, 0), 4.0)
    try:
        ((radiance, opacity),) = shown_images(asset, [pose], 1.75, _PIXELS, 1)
        lit = _lit_wall(asset)
    except LumitreeError as error:
        raise AssertionError(f"what was accepted cannot be rendered: {error}") from error
    for name, values in (("radiance", radiance), ("opacity", opacity), ("the wall", lit)):
        _assert_sound(name, values)


def assert_lamp_renders(source):
    """A lamp is shown, and its geometry is stored; a lamp that Mitsuba cannot make is refused."""
    load_mitsuba(VARIANT)
    register()
    lamp = load_luminaire(source)
    # Parts that an asset cannot hold, such as other plugins, are refused here.
    with contextlib.suppress(LumitreeError):
        stored_geometry(lamp)
    film = {"type": "hdrfilm", "width": _PIXELS, "height": _PIXELS, "rfilter": {"type": "box"}}
    centre, size = lamp.scene_frame.centre, float(lamp.size.max())
    camera = centre + np.array([0, 0.5, 2]) * size
    view = mi.ScalarTransform4f().look_at(camera.tolist(), centre.tolist(), [0, 1, 0])
    sensor = mi.load_dict({"type": "perspective", "to_world": view, "film": film})
    integrator = mi.load_dict({"type": "volpath", "max_depth": 4})
    _assert_sound("the lamp", _rendered(lamp.scene, integrator, sensor))


def _rendered(scene, integrator, sensor):
    render = explained(mi.render)
    return np.array(render(scene, integrator=integrator, sensor=sensor, spp=1))


def _assert_sound(name, values):
    assert np.isfinite(values).all(), f"{name} is not finite"
    assert (values >= 0).all(), f"{name} is {values.min()}"


@contextlib.contextmanager
def coarse_bakes():
    """Context in which the openings of several emitters are divided coarsely."""
    old = light_sources._COARSE, light_sources.MAX_BINS
    light_sources._COARSE, light_sources.MAX_BINS = 8, 1 << 18
    try:
        yield
    finally:
        light_sources._COARSE, light_sources.MAX_BINS = old


def _lit_wall(asset):
    """Radiance [4, 4, 3] of a wall behind an asset, in its local frame."""
    transform = mi.ScalarTransform4f
    film = {"type": "hdrfilm", "width": _PIXELS, "height": _PIXELS, "rfilter": {"type": "box"}}
    view = transform().look_at([0, 3, 6], [0, 0, -3], [0, 1, 0])
    scene = mi.load_dict(
        {
            "type": "scene",
            "lamp": shape(asset, asset.frame.local_from_world),
            "wall": {
                "type": "rectangle",
                "to_world": transform().translate([0, 0, -3]).scale(4),
            },
            "sensor": {"type": "perspective", "to_world": view, "film": film},
            "integrator": {"type": "lumitree_path", "max_depth": 6},
        }
    )
    return np.array(mi.render(scene, spp=4))
