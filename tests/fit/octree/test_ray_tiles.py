"""Random rays: uniform, in tiles, and more even than random ones."""

import numpy as np
import pytest

from support.lamps import AREA, cube
from support.traced_lamps import TILE, arrays, distance_to, source, stream, tile_mean


@pytest.fixture
def box(lamp):
    """Rays of a luminaire with half sides 1, 0.5 and 0.4 local units."""
    return source(lamp(cube("box", (2, 1, 0.8), (3, 0, 0), AREA)))


def test_rays_meet_convex_bodies_in_proportion_to_their_surface(box):
    o, d = arrays(*box.random_rays(1 << 20, stream(1)))
    # Rays start on a box that is larger by half a tile's diagonal.
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
        # The directions of the rays that meet a ball are uniform.
        outer = d[:, :, None] * d[:, None, :] * hit[:, None, None]
        moment, error = tile_mean(outer)
        assert (np.abs(moment - share * np.eye(3) / 3) < 4.5 * error + 1e-6).all()
        mean, error = tile_mean(d * hit[:, None])
        assert (np.abs(mean) < 4.5 * error).all()


def test_corners_of_the_box_get_as_many_rays_as_its_centre(lamp):
    """Also with tiles so wide that the centres of many that reach into a corner are outside."""
    box = source(lamp(cube("box", (2, 1, 0.8), (3, 0, 0), AREA)), spacing=1 / 16)
    o, d = arrays(*box.random_rays(1 << 20, stream(1)))
    radius = 0.08
    for centre in ((0, 0, 0), (0.92, -0.42, 0.32), (-0.92, 0.42, 0.32)):
        share, error = tile_mean((distance_to(o, d, centre) < radius).astype(float))
        assert share == pytest.approx(4 * np.pi**2 * radius**2 / box.measure, abs=4 * error)
        assert error < 0.03 * share


def test_tiles_are_spread_more_evenly_than_random_ones(box):
    """By the variance, from batch to batch, of the number of rays that meet a ball."""
    shares, variances = [], []
    for batch in range(40):
        o, d = arrays(*box.random_rays(1 << 16, stream(batch)))
        share, error = tile_mean((distance_to(o, d, (0.4, 0.1, 0)) < 0.3).astype(float))
        shares.append(share)
        variances.append(error**2)
    assert np.var(shares, ddof=1) < 0.25 * np.mean(variances)


def test_rays_of_a_tile_are_close_and_parallel(box):
    o, d = arrays(*box.random_rays(1 << 12, stream(1)))
    assert np.linalg.norm(d, axis=1) == pytest.approx(1, abs=1e-5)
    tiles, directions = o.reshape(-1, TILE, 3), d.reshape(-1, TILE, 3)
    assert (directions == directions[:, :1]).all()
    assert len(np.unique(directions[:, 0], axis=0)) == len(directions)
    span = np.ptp(np.einsum("tnk,tk->tn", tiles, directions[:, 0]), axis=1)
    assert span == pytest.approx(0, abs=1e-5)
    # Each in its own square of the tile: all are within a diagonal, and none is on another.
    apart = np.linalg.norm(tiles[:, :, None] - tiles[:, None], axis=-1)
    assert apart.max() <= 4 * np.sqrt(2) * box.spacing * 1.001
    assert np.sort(apart, axis=2)[:, :, 1].mean() > 0.3 * box.spacing
