"""Segments of light paths that end on the luminaire, against closed forms and a slow reference."""

import numpy as np
import pytest

from lumitree.trace.light_paths import trace_light
from lumitree.trace.segments import EndingConfig
from support.lamps import AREA, GLASS, cube, lamp_of, sphere

BLACK = '<bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf>'
NULL = '<bsdf type="null"/>'
MASK = '<bsdf type="mask"><float name="opacity" value="0.4"/><bsdf type="diffuse"/></bsdf>'
LOOP_DEPTH = 64


def trace(mi, lamp, count, seed=1, depth=3):
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    ending = EndingConfig(depth, seed + 100)
    return trace_light(lamp, sampler, count, LOOP_DEPTH, all_light=True, ending=ending)


def straight_part(segments):
    """Flux [N, 3] of segments that are straight light, 0 of others."""
    return np.where(np.array(segments.straight)[:, None], numbers(segments)[2], 0)


def numbers(segments):
    """Origin [N, 3], direction [N, 3], flux [N, 3], reach [N]."""
    arrays = (segments.origin, segments.direction, segments.flux)
    return *(np.array(each, np.float64).T for each in arrays), np.array(segments.reach, np.float64)


@pytest.fixture
def shaded(tmp_path):
    """A ball in front of a mirror-like wall, below a mask: light that ends in many ways."""
    wall = '<bsdf type="roughconductor"><float name="alpha" value="0.3"/></bsdf>'
    shapes = sphere("ball", 0.3, inside=AREA), cube("wall", (1, 0.05, 1), (0, -0.8, 0), wall)
    return lamp_of(tmp_path, *shapes, cube("mask", (0.9, 0.02, 0.9), (0, 0.7, 0), MASK))


def test_the_paths_are_the_same(mi, shaded):
    """To the last bit, because light fields are the same with it."""
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, 1 << 12)
    alone = trace_light(shaded, sampler, 1 << 12, LOOP_DEPTH, all_light=True)
    assert alone.ending is None
    beside = trace(mi, shaded, 1 << 12)
    for name in ("origin", "direction", "flux", "straight", "exit", "termination"):
        assert np.array_equal(np.array(getattr(alone, name)), np.array(getattr(beside, name)))


@pytest.mark.parametrize("shells", [0, 3])
def test_a_small_ball_in_a_black_sphere(mi, tmp_path, shells):
    """All light ends on the sphere; null surfaces on its way change nothing."""
    radius = 0.01
    null = [sphere(f"null{i}", 0.2 + 0.1 * i, inside=NULL) for i in range(shells)]
    lamp = lamp_of(
        tmp_path, sphere("ball", radius, inside=AREA), sphere("black", 1, inside=BLACK), *null
    )
    paths = trace(mi, lamp, 1 << 14)
    origin, direction, flux, reach = numbers(paths.ending)
    assert not np.array(paths.flux).any()
    assert len(flux) == 1 << 14
    expected = 4 * np.pi**2 * radius**2 * np.array([3, 2, 1])
    assert flux.sum(axis=0) == pytest.approx(expected, rel=1e-3)
    assert np.linalg.norm(origin, axis=1) == pytest.approx(radius, abs=2e-4)
    assert np.linalg.norm(origin + reach[:, None] * direction, axis=1) == pytest.approx(1, abs=1e-3)
    assert np.abs(reach - 1).max() < 1.1 * radius


def test_light_that_leaves_through_null_surfaces_does_not_end(mi, tmp_path):
    """It starts at the emitter; `exit` is on the last null surface."""
    shapes = [sphere(f"null{i}", 0.5 + 0.25 * i, inside=NULL) for i in range(3)]
    lamp = lamp_of(tmp_path, sphere("ball", 0.01, inside=AREA), *shapes)
    paths = trace(mi, lamp, 1 << 12)
    assert not numbers(paths.ending)[2].any()
    assert np.array(paths.straight).all()
    assert np.linalg.norm(np.array(paths.origin), axis=0) == pytest.approx(0.01, abs=2e-4)
    assert np.linalg.norm(np.array(paths.exit), axis=0) == pytest.approx(1, abs=2e-3)


def test_a_bare_ball_has_none(mi, tmp_path):
    paths = trace(mi, lamp_of(tmp_path, sphere("ball", 1, inside=AREA)), 1 << 10)
    _, direction, flux, _ = numbers(paths.ending)
    assert not flux.any()
    assert np.isfinite(direction).all()


def test_segments_within_a_cell_do_not_count(mi, tmp_path):
    """All of the light ends in the cell of a grid of two cells a side."""
    box = cube("box", 0.2, (0.5, 0.5, 0.5), BLACK), cube("far", 0.01, (-0.99, -0.99, -0.99))
    lamp = lamp_of(tmp_path, sphere("ball", 0.05, (0.5, 0.5, 0.5), AREA), *box)
    flux = [numbers(trace(mi, lamp, 1 << 12, depth=depth).ending)[2].sum() for depth in (1, 5)]
    assert flux[0] == 0
    frame = lamp.frame.scale
    assert flux[1] == pytest.approx(6 * 4 * np.pi**2 * (0.05 / frame) ** 2, rel=0.01)


def reference(mi, lamp, count, seed, depth):
    """Flux [3], flux times reach [3] and straight flux [3] of ending segments, event by event."""
    import drjit as dr

    from lumitree.trace import light_paths
    from lumitree.trace.spawning import scene_extent, spawn

    scene = lamp.scene
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    extent = scene_extent(scene)
    ray, flux = light_paths.emit(lamp.emitting_surfaces, sampler, extent)[:2]
    context = mi.BSDFContext(mi.TransportMode.Importance)
    to_local = lamp.scene_frame.local_from_world
    side = 1 << depth
    active = np.ones(count, bool)
    # Evaluated as a whole after emission and after each event, with the random numbers' state:
    # else each array would have a kernel of its own, and each event longer ones.
    sampler.schedule_state()
    dr.eval(ray, flux)
    begin = np.array(ray.o).T
    straight = np.ones(count, bool)
    total, moment, at_once = np.zeros(3), np.zeros(3), np.zeros(3)
    for _ in range(LOOP_DEPTH):
        si = scene.ray_intersect(ray, mi.Bool(active))
        sample, weight = si.bsdf().sample(context, si, sampler.next_1d(), sampler.next_2d())
        is_valid, is_null = si.is_valid(), mi.has_flag(sample.sampled_type, mi.BSDFFlags.Null)
        weighted, following = flux * weight, spawn(si, si.to_world(sample.wo), extent)
        sampler.schedule_state()
        dr.eval(si.p, is_valid, is_null, weighted, following)
        valid = np.array(is_valid)
        null = np.array(is_null) & valid
        end = np.array(si.p).T
        stops = active & valid & ~null
        start, stop = (points @ to_local[:3, :3].T + to_local[:3, 3] for points in (begin, end))
        cells = [np.clip(np.floor((each + 1) * side / 2), 0, side - 1) for each in (start, stop)]
        stops &= (cells[0] != cells[1]).any(axis=1)
        carried = np.array(flux).T[stops]
        total += carried.sum(axis=0)
        at_once += carried[straight[stops]].sum(axis=0)
        moment += (carried * np.linalg.norm(stop - start, axis=1)[stops, None]).sum(axis=0)
        flux, ray = weighted, following
        active &= valid & (np.array(flux).max(axis=0) > 0)
        begin = np.where((active & ~null)[:, None], np.array(ray.o).T, begin)
        straight &= null
        if not active.any():
            break
    scale = count * lamp.frame.scale**2
    return total / scale, moment / scale, at_once / scale


def test_flux_and_reach_are_those_of_a_slow_trace(mi, shaded):
    """Means of independent batches, by a z-test."""
    found, expected = [], []
    for seed in range(16):
        segments = trace(mi, shaded, 1 << 13, seed).ending
        flux, reach = numbers(segments)[2:]
        each = flux, flux * reach[:, None], straight_part(segments)
        found.append([values.sum(axis=0) for values in each])
        expected.append(reference(mi, shaded, 1 << 13, 1000 + seed, 3))
    found, expected = np.array(found), np.array(expected)
    error = np.sqrt((found.var(axis=0, ddof=1) + expected.var(axis=0, ddof=1)) / 16)
    difference = found.mean(axis=0) - expected.mean(axis=0)
    assert (np.abs(difference) < 4 * error).all()
    assert (error < 0.01 * expected.mean(axis=0)).all()


def test_light_behind_glass_ends_at_the_glass(mi, tmp_path):
    """Each crossing of glass ends a segment and begins one."""
    lamp = lamp_of(
        tmp_path,
        sphere("ball", 0.01, inside=AREA),
        sphere("glass", 0.5, inside=GLASS),
        sphere("black", 1, inside=BLACK),
    )
    paths = trace(mi, lamp, 1 << 14)
    origin, direction, flux, reach = numbers(paths.ending)
    ends = np.linalg.norm(origin + reach[:, None] * direction, axis=1)
    begins = np.linalg.norm(origin, axis=1)
    for radius in (0.5, 1.0):
        assert (np.abs(ends - radius) < 2e-3).any()
    assert ((np.abs(ends - 0.5) < 2e-3) | (np.abs(ends - 1) < 2e-3) | (ends < 0.02)).all()
    # All emitted light gets to the black sphere in the end, most of it at once.
    straight = np.array(paths.ending.straight)
    assert np.array_equal(straight, begins < 0.02)
    last = flux[ends > 0.9].sum(axis=0)
    assert (begins[ends > 0.9] > 0.49).all()
    expected = 4 * np.pi**2 * 1e-4 * np.array([3, 2, 1])
    assert last == pytest.approx(expected, rel=0.05)
