"""Batches of traced rays: what is traced along them, against closed forms and camera paths."""

import numpy as np
import pytest

from support.lamps import AREA, cube, sphere
from support.slow import slow
from support.traced_lamps import (
    CLUTTER,
    arrays,
    everywhere,
    fresnel,
    pane,
    source,
    stream,
    tile_mean,
)

RADIANCE = np.array([3.0, 2.0, 1.0])


@pytest.fixture
def box(lamp):
    """Rays of a luminaire with half sides 1, 0.5 and 0.4 local units."""
    return source(lamp(cube("box", (2, 1, 0.8), (3, 0, 0), AREA)))


def downwards(origin, direction):
    return direction.z < -0.2


def test_equal_seeds_give_equal_rays_and_other_batches_do_not(lamp):
    luminaire = lamp(cube("box", 1, (3, 0, 0), AREA), sphere("ball", 0.3, (3, 0, 1.4)))

    def drawn(seed, batch):
        rays = source(luminaire, seed=seed).draw(1 << 12, stream(batch), downwards, 0.5)
        share = np.array(rays.share)
        assert np.array_equal(np.sort(share), share[::-1])
        values = arrays(rays.origin, rays.direction, rays.light, rays.transmittance)
        return np.column_stack([*values, share])

    first = drawn(1, 2)
    assert np.array_equal(first, drawn(1, 2))
    is_ray = first[:, -1] > 0
    assert (first[is_ray, 5] < 0).all()
    assert 1000 < is_ray.sum() < len(first)
    for other in (drawn(1, 3), drawn(2, 2)):
        # No ray is in both.
        assert len(np.unique(np.concatenate([first, other]), axis=0)) == len(first) + len(other)


def test_order_of_batches_does_not_matter(box):
    """A batch is the same whatever was drawn before. Resuming depends on it."""
    first = arrays(*box.random_rays(1 << 10, stream(5)))
    box.draw_terminated(1 << 10, stream(9))
    for one, two in zip(first, arrays(*box.random_rays(1 << 10, stream(5))), strict=True):
        assert np.array_equal(one, two)


@pytest.mark.parametrize("paths", [1, 3])
def test_mean_radiance_is_the_flux(lamp, paths):
    rays = source(lamp(sphere("lamp", 2.0, (5, 1, 0), AREA)))
    radiance, through = arrays(*rays.trace(*rays.random_rays(1 << 19, stream(3)), stream(3), paths))
    flux, error = tile_mean(radiance)
    assert rays.measure * flux == pytest.approx(4 * np.pi**2 * RADIANCE, rel=0.02)
    assert (np.abs(rays.measure * flux - 4 * np.pi**2 * RADIANCE) < 4 * rays.measure * error).all()
    assert np.array_equal(through == 0, radiance[:, 0] > 0)


@pytest.mark.parametrize("kind", ["thin", "solid"])
@pytest.mark.parametrize("degrees", [0, 35, 60])
def test_transmittance_of_a_pane_is_fresnels(mi, lamp, kind, degrees):
    """Through chains of transmissions alone: (1 - F)² for a slab, (1 - F) / (1 + F) if thin."""
    luminaire = lamp(pane(kind, 0.5), sphere("lamp", 0.01, (0, 0.99, 0), AREA))
    angle = np.deg2rad(degrees)
    direction = [float(np.sin(angle)), 0.0, float(-np.cos(angle))]
    scale, centre = luminaire.frame.world_from_local[0, 0], luminaire.frame.world_from_local[:3, 3]
    inside_pane = (np.array([0, 0, 0.5]) - centre) / scale
    rays = source(luminaire)
    _, through = rays.trace(mi.Point3f(inside_pane.tolist()), mi.Vector3f(direction), stream(1), 4)
    f = fresnel(np.cos(angle), 1.5)
    expected = {"thin": (1 - f) / (1 + f), "solid": (1 - f) ** 2}[kind]
    assert np.array(through) == pytest.approx(expected, abs=1e-5)


@pytest.mark.parametrize("wanted", [everywhere, slow(downwards)])
def test_drawn_rays_integrate_any_function_of_wanted_rays(lamp, wanted):
    """Rays and light paths together have the means of camera paths alone."""
    rays = source(lamp(*CLUTTER))

    def functions(origin, direction):
        """Some functions [N, 4] that are 0 on unwanted rays."""
        o, d = arrays(origin, direction)
        centre = o - (o * d).sum(axis=1, keepdims=True) * d
        value = [np.ones(len(d)), d[:, 0] > 0, centre[:, 1], np.exp(-9 * (centre**2).sum(axis=1))]
        return np.array(wanted(origin, direction))[:, None] * np.stack(value, axis=1)

    origin, direction = rays.random_rays(1 << 19, stream(1))
    chosen = np.array(wanted(origin, direction))
    radiance, _ = rays.trace(origin, direction, stream(1), 2)
    f = functions(origin, direction)
    products = f[:, :, None] * np.array(radiance, np.float64).T[:, None]
    mean, error = tile_mean(products)
    part = chosen.mean()

    # With any number of light paths per ray.
    per_ray = [0.5, 0.25]
    drawn = [
        rays.draw(1 << 15, stream(batch), wanted, per_ray[batch % 2]) for batch in range(2, 34)
    ]
    sums, shares = [], []
    for batch in drawn:
        f = functions(batch.origin, batch.direction)
        light, share = arrays(batch.light, batch.share)
        is_ray = share > 0
        assert 0 < is_ray.sum() < len(share)
        assert (np.array(batch.transmittance)[~is_ray] == 0).all()
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


def test_a_batch_without_wanted_rays_is_empty(lamp):
    import drjit as dr

    rays = source(lamp(*CLUTTER)).draw(1 << 10, stream(1), lambda o, d: d.z > 2, 0.5)
    assert dr.width(rays.origin) == dr.width(rays.light) == dr.width(rays.share) == 0


def test_pairs_are_independent_means_of_the_same_rays(lamp):
    rays = source(lamp(*CLUTTER))
    pairs = rays.draw_pairs(1 << 17, stream(1), 2)
    origin, direction = rays.random_rays(1 << 17, stream(1))
    assert np.array_equal(np.array(pairs.origin), np.array(origin))
    assert np.array_equal(np.array(pairs.direction), np.array(direction))
    first, second = arrays(pairs.first, pairs.second)
    assert not np.array_equal(first, second)
    difference, error = tile_mean(first - second)
    assert (np.abs(difference) < 4 * error).all()
    # Their noise is not shared: the third mean c gives it as (a - c)(b - c) - (a - c)² / 2.
    third, through = arrays(*rays.trace(origin, direction, stream(2), 2))
    shared, error = tile_mean((first - third) * (second - third) - (first - third) ** 2 / 2)
    assert (np.abs(shared) < 4 * error).all()
    assert ((first - second) ** 2).mean() > 10 * error.max()
    # Smooth transmission alone: no noise.
    assert np.array(pairs.transmittance) == pytest.approx(through, abs=1e-6)


def test_max_radiance_of_a_uniform_lamp_is_its_radiance(lamp):
    from lumitree.fit.octree.config import MaxRadianceConfig

    rays = source(lamp(sphere("lamp", 2.0, (5, 1, 0), AREA)))
    assert rays.max_radiance(1 / 64, MaxRadianceConfig(rays=1 << 18)) == pytest.approx(3)
