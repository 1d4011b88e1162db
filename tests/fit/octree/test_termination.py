"""Termination points of rays, against closed forms and straight-through transmittance."""

import numpy as np
import pytest

from support.lamps import AREA, GLASS, cube, sphere
from support.traced_lamps import (
    CLUTTER,
    arrays,
    distance_to,
    everywhere,
    fog,
    fresnel,
    pane,
    source,
    stream,
    tile_mean,
)

RADIANCE = np.array([3.0, 2.0, 1.0])


def test_rays_terminate_on_an_opaque_surface_with_its_radiance(lamp):
    rays = source(lamp(sphere("lamp", 2.0, (5, 1, 0), AREA)))
    ends = rays.draw_terminated(1 << 14, stream(1))
    o, d, point, radiance = arrays(ends.origin, ends.direction, ends.point, ends.radiance)
    terminated = np.array(ends.terminated)
    distance = distance_to(o, d, 0)
    assert (terminated == (distance < 1))[np.abs(distance - 1) > 1e-4].all()
    assert np.linalg.norm(point[terminated], axis=1) == pytest.approx(1, abs=1e-4)
    # On the side that the ray comes from, and on the ray.
    assert ((point * d).sum(axis=1)[terminated] < 1e-3).all()
    assert distance_to(point[terminated], d[terminated], 0) == pytest.approx(
        distance[terminated], abs=1e-4
    )
    assert radiance[terminated] == pytest.approx(np.tile(RADIANCE, (terminated.sum(), 1)), rel=1e-5)
    assert (radiance[~terminated] == 0).all()


def test_termination_points_are_on_the_ray(lamp):
    """Also behind thick glass, which shows a lamp larger than it is and at another place."""
    ball = sphere("ball", 1, (0, 0, 0), GLASS), sphere("lamp", 0.2, (0.3, 0, 0), AREA)
    ends = source(lamp(*ball)).draw_terminated(1 << 14, stream(1))
    o, d, point, radiance = arrays(ends.origin, ends.direction, ends.point, ends.radiance)
    terminated = np.array(ends.terminated)
    off = point - o
    off -= (off * d).sum(axis=1, keepdims=True) * d
    assert terminated.sum() > 1000
    assert np.linalg.norm(off[terminated], axis=1).max() < 1e-5
    # The ball is a lens: the lamp, of radius 0.2, is seen along rays that pass beside it.
    lit = terminated & (radiance.max(axis=1) > 0)
    passed = distance_to(o, d, np.array([0.3, 0, 0]))[lit]
    assert lit.sum() > 300
    assert np.quantile(passed, 0.99) > 0.25


def test_rays_terminate_in_fog_at_its_rate(lamp):
    """Their number minus rate times length is a martingale: mean 0, variance rate times length."""
    radius, sigma = 2.0, 0.75
    ball = sphere("fog", radius, inside=fog(sigma))
    rays = source(lamp(ball, sphere("lamp", 0.01, inside=AREA)))
    ends = rays.draw_terminated(1 << 17, stream(1))
    o, d, point = arrays(ends.origin, ends.direction, ends.point)
    terminated = np.array(ends.terminated)
    distance = distance_to(o, d, 0)
    crosses = (distance < 0.999) & (distance > 0.006)
    half_chord = np.sqrt(np.maximum(1 - distance**2, 0))
    middle = -(o * d).sum(axis=1)
    entry = middle - half_chord
    end = np.where(terminated, ((point - o) * d).sum(axis=1), middle + half_chord)
    assert not terminated[distance > 1.001].any()
    assert np.linalg.norm(point[terminated], axis=1).max() < 1.001
    rate = sigma * radius
    # In the first and in the second half of every chord.
    for low, high in ((entry, middle), (middle, middle + half_chord)):
        length = np.clip(end - low, 0, high - low)[crosses].sum()
        count = (crosses & terminated & (end >= low) & (end < high)).sum()
        assert abs(count - rate * length) < 4 * np.sqrt(rate * length)
        assert count > 1000
    through = np.array(rays.trace(ends.origin, ends.direction, stream(1), 1)[1])
    # Mitsuba starts rays a little off a surface, which shortens grazing chords.
    steep = crosses & (distance < 0.9)
    assert through[steep] == pytest.approx(np.exp(-rate * 2 * half_chord)[steep], abs=2e-3)


def test_rays_terminate_at_a_pane_as_often_as_it_reflects(lamp):
    luminaire = lamp(pane("thin", 1), cube("lamp", (1, 1, 0.1), (0, 0, 0), AREA))
    rays = source(luminaire)
    ends = rays.draw_terminated(1 << 16, stream(1))
    o, d, point, radiance = arrays(ends.origin, ends.direction, ends.point, ends.radiance)
    centre = luminaire.frame.world_from_local[:3, 3]
    world_point = point * luminaire.frame.world_from_local[0, 0] + centre
    world = o * luminaire.frame.world_from_local[0, 0] + centre

    def at(z):
        return world + (z - world[:, 2:]) / d[:, 2:] * d

    down = d[:, 2] < -0.3
    chosen = down & (np.abs(np.hstack([at(1)[:, :2], at(0.1)[:, :2]])) < 0.99).all(axis=1)
    assert np.array(ends.terminated)[chosen].all()
    at_pane = np.abs(world_point[:, 2] - 1) < 1e-3
    at_lamp = np.abs(world_point[:, 2] - 0.1) < 1e-3
    assert (at_pane | at_lamp)[chosen].all()
    f = fresnel(-d[chosen, 2], 1.5)
    reflected = 2 * f / (1 + f)
    variance = (reflected * (1 - reflected)).sum()
    assert abs(at_pane[chosen].sum() - reflected.sum()) < 4 * np.sqrt(variance)
    assert at_pane[chosen].sum() > 100
    assert world_point[chosen & at_pane] == pytest.approx(at(1)[chosen & at_pane], abs=1e-3)
    # Nothing is seen in reflection by the pane; the emitter is seen with all of its radiance.
    assert (radiance[chosen & at_pane] == 0).all()
    lit = chosen & at_lamp
    assert radiance[lit] == pytest.approx(np.tile(RADIANCE, (lit.sum(), 1)), rel=1e-4)


@pytest.mark.parametrize("extra", [(), (sphere("fog", 0.4, (0, -0.9, 0), fog(2.0)),)])
def test_terminated_rays_agree_with_straight_through_ones(lamp, extra):
    """Means of one random transmission at each surface, against the expected throughput."""
    luminaire = lamp(*CLUTTER, *extra)
    assert luminaire.has_media == bool(extra)
    rays = source(luminaire)
    count = 1 << 18
    ends = rays.draw_terminated(count, stream(1))
    drawn = rays.draw(count, stream(1), everywhere, 0.5)
    origin, light = arrays(drawn.origin, drawn.light)
    assert np.array_equal(origin[:count], arrays(ends.origin)[0])
    seen = count * light[:count]
    difference, error = tile_mean(np.array(ends.radiance).T - seen)
    assert (np.abs(difference) < 4 * error).all()
    assert (error < 0.02 * seen.mean(axis=0)).all()
    opaque, error = tile_mean(np.array(ends.terminated) - 1 + np.array(drawn.transmittance)[:count])
    assert abs(opaque) < 4 * error


def test_rays_terminate_at_absorbing_glass(lamp):
    """A pane with a transmittance of 0."""
    black = (
        '<shape type="rectangle" id="pane"><bsdf type="thindielectric">'
        '<rgb name="specular_transmittance" value="0"/></bsdf></shape>'
    )
    rays = source(lamp(black, sphere("lamp", 0.05, (0, 0, 0.9), AREA)))
    ends = rays.draw_terminated(1 << 14, stream(1))
    o, d, point = arrays(ends.origin, ends.direction, ends.point)
    luminaire = rays.luminaire
    height = -luminaire.frame.world_from_local[2, 3] / luminaire.frame.world_from_local[0, 0]
    crossing = o + (height - o[:, 2:]) / d[:, 2:] * d
    first = (np.abs(crossing[:, :2]) < 0.99).all(axis=1) & (d[:, 2] > 0.1)
    assert np.array(ends.terminated)[first].all()
    assert point[first] == pytest.approx(crossing[first], abs=1e-3)
