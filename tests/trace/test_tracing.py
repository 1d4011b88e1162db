"""Which integrator traces a luminaire, and what it makes of coloured media."""

import numpy as np
import pytest

from lumitree.rendering.scene import place_shapes
from lumitree.trace.cameras import path_integrator
from support.lamps import AREA, cube, lamp_of, sphere

LAMP = (
    '<shape type="sphere" id="lamp"><point name="center" x="9" y="0" z="3"/>'
    '<float name="radius" value="0.1"/><bsdf type="diffuse"/>'
    '<emitter type="area"><rgb name="radiance" value="1"/></emitter></shape>'
)


def load(tmp_path, sigma_t, albedo="0", scale=1):
    """A slab of unit thickness without surfaces, and a lamp."""
    slab = (
        '<shape type="cube" id="slab"><transform name="to_world">'
        '<scale x="50" y="50" z="0.5"/></transform><bsdf type="null"/>'
        f'<medium type="homogeneous" name="interior"><float name="scale" value="{scale}"/>'
        f'<rgb name="sigma_t" value="{sigma_t}"/><rgb name="albedo" value="{albedo}"/>'
        "</medium></shape>"
    )
    return lamp_of(tmp_path, slab, LAMP)


def looked_through(mi, tmp_path, luminaire, count=1 << 16):
    """Radiance [3, count] of paths through the slab, under radiance 1 from everywhere."""
    import drjit as dr

    furnace = mi.load_dict(
        {"type": "scene", "light": {"type": "constant", "radiance": 1.0}}
        | place_shapes(tmp_path / "lamp.xml", np.eye(4))
    )
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, count)
    origin = mi.Point3f(0, 0, -3) + dr.zeros(mi.Point3f, count)
    ray = mi.RayDifferential3f(mi.Ray3f(origin, mi.Vector3f(0, 0, 1)))
    radiance, _, _ = path_integrator(luminaire, 64).sample(furnace, sampler, ray)
    return np.array(radiance, np.float64)


@pytest.mark.parametrize(
    ("sigma_t", "albedo", "expected"),
    [
        ("0.5, 0.5, 0.5", "0", "VolumetricSimplePath"),
        ("0.5, 0.2, 0.1", "0", "VolumetricMisPath"),
        ("0.5, 0.2, 0.1", "0.5", "VolumetricSimplePath"),
    ],
    ids=["grey", "coloured", "scattering"],
)
def test_integrator_suits_the_media(mi, tmp_path, sigma_t, albedo, expected):
    integrator = path_integrator(load(tmp_path, sigma_t, albedo), 32)
    assert str(integrator).startswith(expected)


def test_next_event_estimation_crosses_masks(mi, tmp_path):
    """An emitter in a mask, which other paths would hit one time in ten thousand."""
    emitter = '<emitter type="area"><rgb name="radiance" value="1e6"/></emitter>'
    mask = '<bsdf type="mask"><float name="opacity" value="0.5"/><bsdf type="diffuse"/></bsdf>'
    plate = cube("plate", (3, 0.1, 3), (0, -2, 0))
    shapes = sphere("lamp", 0.05, inside=emitter), sphere("shade", 1, inside=mask), plate
    lamp = lamp_of(tmp_path, *shapes)
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(3, 1 << 14)
    at = mi.Point2f(2, 0) + 0.1 * sampler.next_2d()
    ray = mi.RayDifferential3f(mi.Ray3f(mi.Point3f(at.x, -1, at.y), mi.Vector3f(0, -1, 0)))
    radiance, _, _ = path_integrator(lamp, 2).sample(lamp.scene, sampler, ray)
    irradiance = 0.5 * 1e6 * np.pi * 0.05**2 * 1.9 / (1.9**2 + 2.05**2 + 0.05**2) ** 1.5
    assert np.array(radiance[1]).mean() == pytest.approx(0.5 * irradiance / np.pi, rel=0.02)


def test_media_are_not_told_by_names(mi, tmp_path):
    """A coloured surface whose id reads like the parameter of a medium."""
    slab = (
        '<shape type="cube" id="interior_medium.albedo.x"><bsdf type="null"/>'
        '<medium type="homogeneous" name="interior">'
        '<rgb name="sigma_t" value="0.5, 0.2, 0.1"/><rgb name="albedo" value="0"/></medium></shape>'
    )
    surface = (
        '<shape type="sphere" id="a_medium.albedo."><bsdf type="diffuse">'
        '<rgb name="reflectance" value="0.5"/></bsdf></shape>'
    )
    integrator = path_integrator(lamp_of(tmp_path, slab, surface, LAMP), 32)
    assert str(integrator).startswith("VolumetricMisPath")


def test_strongly_coloured_slab_follows_beer_without_fireflies(mi, tmp_path):
    radiance = looked_through(mi, tmp_path, load(tmp_path, "1, 0.2, 0", scale=5))
    noise = radiance.std(axis=1) / np.sqrt(radiance.shape[1])
    assert np.all(np.abs(radiance.mean(axis=1) - np.exp([-5, -1, 0])) < 4 * noise + 1e-4)
    # Three channels sampled alike: a weight is at most 3, where volpath has e⁵.
    assert radiance.max() <= 3


def test_medium_that_is_clear_in_one_channel_scatters_in_the_others(mi, tmp_path):
    """An extinction of 0 would make volpath divide by it: every pixel not a number."""
    radiance = looked_through(mi, tmp_path, load(tmp_path, "1, 1, 0", "0.9"))
    assert np.isfinite(radiance).all()
    # Less light of a furnace is absorbed than along a straight ray.
    assert radiance[0].mean() > np.exp(-1) + 0.1
    assert radiance[2].mean() == pytest.approx(1, abs=0.05)


def test_emitters_through_which_light_passes_are_seen(mi, tmp_path):
    """Rays meet nothing but null surfaces."""
    from lumitree.core.frames import pose_towards
    from lumitree.trace.cameras import Camera
    from support.traced_lamps import stream

    null = '<bsdf type="null"/>'
    lamp = lamp_of(tmp_path, sphere("glow", 1, inside=AREA + null))
    assert path_integrator(lamp, 8).class_name() == "VolumetricPathIntegrator"
    image = Camera(lamp, 8, 4).take(pose_towards((0, 0, 1), (0, 1, 0), 4.0), stream(1))
    # The rays cross the near side and the far side, of which the inner one does not emit.
    assert image.radiance[3, 4] == pytest.approx([3, 2, 1], rel=1e-4)
