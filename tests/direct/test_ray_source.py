"""Lines that are uniform, and what is traced along them, against what is known in closed form."""

import numpy as np
import pytest
from lines import CLUTTER, TILE, arrays, fog, source, stream, tile_mean

from lamps import AREA, GLASS, cube, sphere

RADIANCE = np.array([3.0, 2.0, 1.0])


def distance_to(origins, directions, centre):
    offset = origins - centre
    along = (offset * directions).sum(axis=1, keepdims=True)
    return np.linalg.norm(offset - along * directions, axis=1)


@pytest.fixture
def box(lamp):
    """Rays of a luminaire with half sides 1, 0.5 and 0.4 local units."""
    return source(lamp(cube("box", (2, 1, 0.8), (3, 0, 0), AREA)))


def test_lines_meet_convex_bodies_in_proportion_to_their_surface(box):
    o, d = arrays(*box.lines(1 << 20, stream(1)))
    # Of a box that is larger by half a tile's diagonal.
    x, y, z = np.array([1, 0.5, 0.4]) + 2 * np.sqrt(2) * box.spacing
    surface = 8 * (x * y + y * z + z * x)
    assert box.measure == pytest.approx(np.pi * surface)
    for centre, radius in (((0.6, 0.1, 0), 0.25), ((-0.4, -0.2, 0.1), 0.15)):
        distance = distance_to(o, d, centre)
        hit = distance < radius
        share, error = tile_mean(hit.astype(float))
        assert share == pytest.approx(4 * np.pi * radius**2 / surface, abs=4 * error)
        assert error < 0.03 * share
        # Cauchy: the mean chord is 4 V / S.
        chord = 2 * np.sqrt(np.maximum(radius**2 - distance**2, 0))
        length, error = tile_mean(chord)
        expected = 4 / 3 * radius * 4 * np.pi * radius**2 / surface
        assert length == pytest.approx(expected, abs=4 * error)
        # All directions are equally likely for what does not know its orientation.
        outer = d[:, :, None] * d[:, None, :] * hit[:, None, None]
        moment, error = tile_mean(outer)
        assert (np.abs(moment - share * np.eye(3) / 3) < 4.5 * error + 1e-6).all()
        mean, error = tile_mean(d * hit[:, None])
        assert (np.abs(mean) < 4.5 * error).all()


def test_corners_of_the_box_get_as_many_lines_as_its_middle(lamp):
    """Also where tiles are so wide that many that reach into a corner have their middle outside."""
    box = source(lamp(cube("box", (2, 1, 0.8), (3, 0, 0), AREA)), spacing=1 / 16)
    o, d = arrays(*box.lines(1 << 20, stream(1)))
    radius = 0.08
    for centre in ((0, 0, 0), (0.92, -0.42, 0.32), (-0.92, 0.42, 0.32)):
        share, error = tile_mean((distance_to(o, d, centre) < radius).astype(float))
        assert share == pytest.approx(4 * np.pi**2 * radius**2 / box.measure, abs=4 * error)
        assert error < 0.03 * share


def test_tiles_are_spread_more_evenly_than_random_ones(box):
    """By the variance, from batch to batch, of how many lines meet a ball."""
    shares, variances = [], []
    for batch in range(40):
        o, d = arrays(*box.lines(1 << 16, stream(batch)))
        share, error = tile_mean((distance_to(o, d, (0.4, 0.1, 0)) < 0.3).astype(float))
        shares.append(share)
        variances.append(error**2)
    assert np.var(shares, ddof=1) < 0.25 * np.mean(variances)


def test_lines_of_a_tile_are_close_and_parallel(box):
    o, d = arrays(*box.lines(1 << 12, stream(1)))
    assert np.linalg.norm(d, axis=1) == pytest.approx(1, abs=1e-5)
    tiles, directions = o.reshape(-1, TILE, 3), d.reshape(-1, TILE, 3)
    assert (directions == directions[:, :1]).all()
    assert len(np.unique(directions[:, 0], axis=0)) == len(directions)
    span = np.ptp(np.einsum("tnk,tk->tn", tiles, directions[:, 0]), axis=1)
    assert span == pytest.approx(0, abs=1e-5)
    # Each in its own square of the tile: a diagonal holds all of them, none is on another.
    apart = np.linalg.norm(tiles[:, :, None] - tiles[:, None], axis=-1)
    assert apart.max() <= 4 * np.sqrt(2) * box.spacing * 1.001
    assert np.sort(apart, axis=2)[:, :, 1].mean() > 0.3 * box.spacing


def test_equal_seeds_give_equal_rays_and_other_batches_do_not(lamp):
    luminaire = lamp(cube("box", 1, (3, 0, 0), AREA), sphere("ball", 0.3, (3, 0, 1.4)))

    def drawn(seed, batch):
        rays = source(luminaire, seed=seed).draw(1 << 12, stream(batch), lambda o, d: d.z < 0)
        share = np.array(rays.share)
        assert np.array_equal(np.sort(share), share[::-1])
        all_of_it = arrays(rays.origin, rays.direction, rays.light, rays.transmittance)
        return np.column_stack([*all_of_it, share])

    first = drawn(1, 2)
    assert np.array_equal(first, drawn(1, 2))
    is_line = first[:, -1] > 0
    assert (first[is_line, 5] < 0).all()
    assert 1000 < is_line.sum() < len(first)
    for other in (drawn(1, 3), drawn(2, 2)):
        # No line is shared.
        assert len(np.unique(np.concatenate([first, other]), axis=0)) == len(first) + len(other)


def test_order_of_batches_does_not_matter(box):
    """A batch is the same whatever was drawn before: what resuming relies on."""
    first = arrays(*box.lines(1 << 10, stream(5)))
    box.stops(1 << 10, stream(9))
    for one, two in zip(first, arrays(*box.lines(1 << 10, stream(5))), strict=True):
        assert np.array_equal(one, two)


@pytest.mark.parametrize("paths", [1, 3])
def test_mean_radiance_is_the_flux(lamp, paths):
    rays = source(lamp(sphere("lamp", 2.0, (5, 1, 0), AREA)))
    radiance, through = arrays(*rays.trace(*rays.lines(1 << 19, stream(3)), stream(3), paths))
    flux, error = tile_mean(radiance)
    assert rays.measure * flux == pytest.approx(4 * np.pi**2 * RADIANCE, rel=0.02)
    assert (np.abs(rays.measure * flux - 4 * np.pi**2 * RADIANCE) < 4 * rays.measure * error).all()
    assert np.array_equal(through == 0, radiance[:, 0] > 0)


def fresnel(cosine, ior):
    """Reflectance of unpolarised light at a smooth dielectric."""
    inner = np.sqrt(1 - (1 - cosine**2) / ior**2)
    s = (cosine - ior * inner) / (cosine + ior * inner)
    p = (ior * cosine - inner) / (ior * cosine + inner)
    return (s**2 + p**2) / 2


def pane(kind, z):
    """A pane of glass across the box at height z: a thin sheet, or a slab."""
    if kind == "thin":
        return (
            '<shape type="rectangle" id="pane"><transform name="to_world">'
            f'<translate z="{z}"/></transform><bsdf type="thindielectric">'
            '<float name="int_ior" value="1.5"/><float name="ext_ior" value="1"/></bsdf></shape>'
        )
    glass = (
        '<bsdf type="dielectric"><float name="int_ior" value="1.5"/>'
        '<float name="ext_ior" value="1"/></bsdf>'
    )
    return cube("pane", (1, 1, 0.02), (0, 0, z), glass)


@pytest.mark.parametrize("kind", ["thin", "solid"])
@pytest.mark.parametrize("degrees", [0, 35, 60])
def test_transmittance_of_a_pane_is_fresnels(mi, lamp, kind, degrees):
    """Through chains of transmissions alone: (1 - F)² for a slab, (1 - F) / (1 + F) for a sheet."""
    luminaire = lamp(pane(kind, 0.5), sphere("lamp", 0.01, (0, 0.99, 0), AREA))
    angle = np.deg2rad(degrees)
    direction = [float(np.sin(angle)), 0.0, float(-np.cos(angle))]
    scale, centre = luminaire.world_from_proxy[0, 0], luminaire.world_from_proxy[:3, 3]
    inside_pane = (np.array([0, 0, 0.5]) - centre) / scale
    rays = source(luminaire)
    _, through = rays.trace(mi.Point3f(inside_pane.tolist()), mi.Vector3f(direction), stream(1), 4)
    f = fresnel(np.cos(angle), 1.5)
    expected = {"thin": (1 - f) / (1 + f), "solid": (1 - f) ** 2}[kind]
    assert np.array(through) == pytest.approx(expected, abs=1e-5)


def test_paths_stop_on_an_opaque_surface_with_its_radiance(lamp):
    rays = source(lamp(sphere("lamp", 2.0, (5, 1, 0), AREA)))
    stops = rays.stops(1 << 14, stream(1))
    o, d, point, radiance = arrays(stops.origin, stops.direction, stops.point, stops.radiance)
    stopped = np.array(stops.stopped)
    distance = distance_to(o, d, 0)
    assert (stopped == (distance < 1))[np.abs(distance - 1) > 1e-4].all()
    assert np.linalg.norm(point[stopped], axis=1) == pytest.approx(1, abs=1e-4)
    # On the side from which the line comes, and on the line.
    assert ((point * d).sum(axis=1)[stopped] < 1e-3).all()
    assert distance_to(point[stopped], d[stopped], 0) == pytest.approx(distance[stopped], abs=1e-4)
    assert radiance[stopped] == pytest.approx(np.tile(RADIANCE, (stopped.sum(), 1)), rel=1e-5)
    assert (radiance[~stopped] == 0).all()


def test_paths_stop_on_the_line_that_sees_them(lamp):
    """Through thick glass too, which shows a lamp larger and elsewhere than it is."""
    ball = sphere("ball", 1, (0, 0, 0), GLASS), sphere("lamp", 0.2, (0.3, 0, 0), AREA)
    stops = source(lamp(*ball)).stops(1 << 14, stream(1))
    o, d, point, radiance = arrays(stops.origin, stops.direction, stops.point, stops.radiance)
    stopped = np.array(stops.stopped)
    off = point - o
    off -= (off * d).sum(axis=1, keepdims=True) * d
    assert stopped.sum() > 1000
    assert np.linalg.norm(off[stopped], axis=1).max() < 1e-5
    # The ball is a lens: it shows the lamp, of radius 0.2, to lines that pass beside it.
    lit = stopped & (radiance.max(axis=1) > 0)
    passed = distance_to(o, d, np.array([0.3, 0, 0]))[lit]
    assert lit.sum() > 300
    assert np.quantile(passed, 0.99) > 0.25


def test_paths_stop_in_fog_at_its_rate(lamp):
    """Stops less rate times length travelled is a martingale: mean 0, variance rate times length"""
    radius, sigma = 2.0, 0.75
    ball = sphere("fog", radius, inside=fog(sigma))
    rays = source(lamp(ball, sphere("lamp", 0.01, inside=AREA)))
    stops = rays.stops(1 << 17, stream(1))
    o, d, point = arrays(stops.origin, stops.direction, stops.point)
    stopped = np.array(stops.stopped)
    distance = distance_to(o, d, 0)
    crosses = (distance < 0.999) & (distance > 0.006)
    half_chord = np.sqrt(np.maximum(1 - distance**2, 0))
    middle = -(o * d).sum(axis=1)
    entry = middle - half_chord
    end = np.where(stopped, ((point - o) * d).sum(axis=1), middle + half_chord)
    assert not stopped[distance > 1.001].any()
    assert np.linalg.norm(point[stopped], axis=1).max() < 1.001
    rate = sigma * radius
    # In the first and in the second half of every chord.
    for low, high in ((entry, middle), (middle, middle + half_chord)):
        length = np.clip(end - low, 0, high - low)[crosses].sum()
        count = (crosses & stopped & (end >= low) & (end < high)).sum()
        assert abs(count - rate * length) < 4 * np.sqrt(rate * length)
        assert count > 1000
    through = np.array(rays.trace(stops.origin, stops.direction, stream(1), 1)[1])
    # Mitsuba starts rays a little off a surface, which shortens grazing chords.
    steep = crosses & (distance < 0.9)
    assert through[steep] == pytest.approx(np.exp(-rate * 2 * half_chord)[steep], abs=2e-3)


def test_paths_stop_at_a_pane_as_often_as_it_reflects(lamp):
    luminaire = lamp(pane("thin", 1), cube("lamp", (1, 1, 0.1), (0, 0, 0), AREA))
    rays = source(luminaire)
    stops = rays.stops(1 << 16, stream(1))
    o, d, point, radiance = arrays(stops.origin, stops.direction, stops.point, stops.radiance)
    centre = luminaire.world_from_proxy[:3, 3]
    world_point = point * luminaire.world_from_proxy[0, 0] + centre
    world = o * luminaire.world_from_proxy[0, 0] + centre

    def at(z):
        return world + (z - world[:, 2:]) / d[:, 2:] * d

    down = d[:, 2] < -0.3
    chosen = down & (np.abs(np.hstack([at(1)[:, :2], at(0.1)[:, :2]])) < 0.99).all(axis=1)
    assert np.array(stops.stopped)[chosen].all()
    at_pane = np.abs(world_point[:, 2] - 1) < 1e-3
    at_lamp = np.abs(world_point[:, 2] - 0.1) < 1e-3
    assert (at_pane | at_lamp)[chosen].all()
    f = fresnel(-d[chosen, 2], 1.5)
    reflected = 2 * f / (1 + f)
    variance = (reflected * (1 - reflected)).sum()
    assert abs(at_pane[chosen].sum() - reflected.sum()) < 4 * np.sqrt(variance)
    assert at_pane[chosen].sum() > 100
    assert world_point[chosen & at_pane] == pytest.approx(at(1)[chosen & at_pane], abs=1e-3)
    # The pane mirrors nothing; the emitter shows all of its light.
    assert (radiance[chosen & at_pane] == 0).all()
    lit = chosen & at_lamp
    assert radiance[lit] == pytest.approx(np.tile(RADIANCE, (lit.sum(), 1)), rel=1e-4)


def everywhere(origin, direction):
    return direction.z < 2


def downwards(origin, direction):
    return direction.z < -0.2


@pytest.mark.parametrize("extra", [(), (sphere("fog", 0.4, (0, -0.9, 0), fog(2.0)),)])
def test_stops_hide_and_show_what_smooth_transmission_does(lamp, extra):
    """Paths that pick one way each, against all of what lines let through and see."""
    luminaire = lamp(*CLUTTER, *extra)
    assert luminaire.has_media == bool(extra)
    rays = source(luminaire)
    count = 1 << 18
    stops = rays.stops(count, stream(1))
    drawn = rays.draw(count, stream(1), everywhere)
    origin, light = arrays(drawn.origin, drawn.light)
    assert np.array_equal(origin[:count], arrays(stops.origin)[0])
    seen = count * light[:count]
    difference, error = tile_mean(np.array(stops.radiance).T - seen)
    assert (np.abs(difference) < 4 * error).all()
    assert (error < 0.02 * seen.mean(axis=0)).all()
    hidden, error = tile_mean(np.array(stops.stopped) - 1 + np.array(drawn.transmittance)[:count])
    assert abs(hidden) < 4 * error


@pytest.mark.parametrize("wanted", [everywhere, downwards])
def test_drawn_rays_integrate_any_function_of_wanted_lines(lamp, wanted):
    """Lines and light together give the means that camera paths alone give."""
    rays = source(lamp(*CLUTTER))

    def functions(origin, direction):
        """Some functions [N, 4] that are 0 on unwanted lines."""
        o, d = arrays(origin, direction)
        centre = o - (o * d).sum(axis=1, keepdims=True) * d
        value = [np.ones(len(d)), d[:, 0] > 0, centre[:, 1], np.exp(-9 * (centre**2).sum(axis=1))]
        return np.array(wanted(origin, direction))[:, None] * np.stack(value, axis=1)

    origin, direction = rays.lines(1 << 19, stream(1))
    chosen = np.array(wanted(origin, direction))
    radiance, _ = rays.trace(origin, direction, stream(1), 2)
    f = functions(origin, direction)
    products = f[:, :, None] * np.array(radiance, np.float64).T[:, None]
    mean, error = tile_mean(products)
    part = chosen.mean()

    # However many paths from the emitters there are for a line.
    light_share = [0.5, 0.25]
    drawn = [
        rays.draw(1 << 15, stream(batch), wanted, light_share[batch % 2]) for batch in range(2, 34)
    ]
    sums, shares = [], []
    for batch in drawn:
        f = functions(batch.origin, batch.direction)
        light, share = arrays(batch.light, batch.share)
        is_line = share > 0
        assert 0 < is_line.sum() < len(share)
        assert (np.array(batch.transmittance)[~is_line] == 0).all()
        assert share.sum() == pytest.approx(1, rel=1e-4)
        sums.append(f.T @ light)
        shares.append(f.T @ share)
    spread = np.std(sums, axis=0, ddof=1) / np.sqrt(len(sums))
    error = np.hypot(error / part, spread)
    assert (np.abs(np.mean(sums, axis=0) - mean / part) < 4 * error).all()
    assert (error[0] < 0.03 * mean[0] / part).all()
    # The functions alone.
    mean, error = tile_mean(functions(origin, direction))
    spread = np.std(shares, axis=0, ddof=1) / np.sqrt(len(shares))
    tolerance = 4 * np.hypot(error / part, spread) + 1e-6
    assert (np.abs(np.mean(shares, axis=0) - mean / part) < tolerance).all()


def test_no_wanted_line_gives_no_rays(lamp):
    import drjit as dr

    rays = source(lamp(*CLUTTER)).draw(1 << 10, stream(1), lambda o, d: d.z > 2)
    assert dr.width(rays.origin) == dr.width(rays.light) == dr.width(rays.share) == 0


def test_pairs_are_independent_means_of_the_same_lines(lamp):
    rays = source(lamp(*CLUTTER))
    pairs = rays.pairs(1 << 17, stream(1), 2)
    origin, direction = rays.lines(1 << 17, stream(1))
    assert np.array_equal(np.array(pairs.origin), np.array(origin))
    assert np.array_equal(np.array(pairs.direction), np.array(direction))
    first, second = arrays(pairs.first, pairs.second)
    assert not np.array_equal(first, second)
    difference, error = tile_mean(first - second)
    assert (np.abs(difference) < 4 * error).all()
    # Their noise is not shared: with a third mean c, (a - c)(b - c) and (a - c)² know how much.
    third, through = arrays(*rays.trace(origin, direction, stream(2), 2))
    shared, error = tile_mean((first - third) * (second - third) - (first - third) ** 2 / 2)
    assert (np.abs(shared) < 4 * error).all()
    assert ((first - second) ** 2).mean() > 10 * error.max()
    # Smooth transmission alone: no noise.
    assert np.array(pairs.transmittance) == pytest.approx(through, abs=1e-6)


def test_absorbing_glass_stops_what_it_absorbs(lamp):
    """A sheet that lets nothing through hides all, and is where paths stop."""
    black = (
        '<shape type="rectangle" id="pane"><bsdf type="thindielectric">'
        '<rgb name="specular_transmittance" value="0"/></bsdf></shape>'
    )
    rays = source(lamp(black, sphere("lamp", 0.05, (0, 0, 0.9), AREA)))
    stops = rays.stops(1 << 14, stream(1))
    o, d, point = arrays(stops.origin, stops.direction, stops.point)
    luminaire = rays.luminaire
    height = -luminaire.world_from_proxy[2, 3] / luminaire.world_from_proxy[0, 0]
    crossing = o + (height - o[:, 2:]) / d[:, 2:] * d
    first = (np.abs(crossing[:, :2]) < 0.99).all(axis=1) & (d[:, 2] > 0.1)
    assert np.array(stops.stopped)[first].all()
    assert point[first] == pytest.approx(crossing[first], abs=1e-3)


def test_max_radiance_of_a_uniform_lamp_is_its_radiance(lamp):
    rays = source(lamp(sphere("lamp", 2.0, (5, 1, 0), AREA)))
    assert rays.max_radiance(pixel=1 / 64) == pytest.approx(3)
