"""Bins of directions: each direction has one, and directions in a bin have the stated density."""

import numpy as np
import pytest

from lumitree.core.device import on_device
from lumitree.core.octahedral import solid_angles

RESOLUTIONS = (4, 16, 64)


def random_directions(mi, count, seed):
    """Directions [count, 3], uniform on the sphere."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors, on_device(mi.Vector3f, vectors)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_directions_in_a_bin_are_found_in_it(mi, resolution):
    import drjit as dr

    from lumitree.core.octahedral import bin_of, direction_in_bin

    repeats = 64
    bins = np.tile(np.arange(resolution**2), repeats)
    # Rounding moves a direction on the border of a bin into the next one.
    samples = 0.001 + 0.998 * np.random.default_rng(resolution).random((len(bins), 2))
    index = on_device(mi.UInt32, bins)
    direction, density = direction_in_bin(index, on_device(mi.Point2f, samples), resolution)
    np.testing.assert_allclose(dr.norm(direction), 1, atol=1e-6)
    assert np.array_equal(bin_of(direction, resolution), bins)
    # A direction may have any length.
    assert np.array_equal(bin_of(1000 * direction, resolution), bins)
    assert np.array(density).min() > 0


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_borders_have_a_bin(mi, resolution):
    """Samples of 0 and 1 are in their bin or in one that touches it."""
    from lumitree.core.octahedral import bin_of, direction_in_bin

    bins = np.arange(resolution**2)
    index = on_device(mi.UInt32, bins)
    at = np.array(direction_in_bin(index, mi.Point2f(0.5), resolution)[0])
    for x in (0, 1):
        for y in (0, 1):
            direction, density = direction_in_bin(index, mi.Point2f(x, y), resolution)
            found = np.array(bin_of(direction, resolution))
            assert found.max() < resolution**2
            assert np.isfinite(np.array(density)).all()
            # Bins that touch at a corner: their centres are at most two diagonals apart.
            assert (at * at[:, found]).sum(axis=0).min() > np.cos(2 * np.pi / resolution * 1.5)


def test_axes(mi):
    """The poles are in the middle and in the corners; ±x and ±y are in the middle of the sides."""
    from lumitree.core.octahedral import bin_of, octahedral

    axes = np.concatenate([np.eye(3), -np.eye(3)])
    uv = np.array(octahedral(on_device(mi.Vector3f, axes))).T
    assert uv[:5].tolist() == [[1, 0], [0, 1], [0, 0], [-1, 0], [0, -1]]
    assert np.abs(uv[5]).tolist() == [1, 1]
    down = np.array([[1, 1, -9], [-1, 1, -9], [1, -1, -9], [-1, -1, -9]], np.float32)
    corners = bin_of(on_device(mi.Vector3f, down), 8)
    assert np.array(corners).tolist() == [63, 56, 7, 0]


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_densities_integrate_to_one(mi, resolution):
    """Over each bin, from directions that are uniform on the sphere; and over all bins."""
    from lumitree.core.octahedral import bin_density, bin_of

    count = 1 << 20
    _, direction = random_directions(mi, count, 1)
    density = np.array(bin_density(direction, resolution), np.float64)
    bins = np.array(bin_of(direction, resolution))
    assert density.sum() * 4 * np.pi / count == pytest.approx(resolution**2, rel=1e-3)
    weights = density * 4 * np.pi / count
    found = np.bincount(bins, weights, resolution**2)
    error = np.sqrt(np.bincount(bins, weights**2, resolution**2))
    scores = (found - 1) / error
    assert np.abs(scores).max() < 5.5
    assert scores.std() == pytest.approx(1, abs=5 / np.sqrt(2) / resolution)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_directions_have_the_stated_density(mi, resolution):
    """The mean of 1 / density over a bin and its neighbours, bilinear, is its solid angle."""
    from lumitree.core.octahedral import bin_density, direction_in_bin

    fine = 16
    places = (np.arange(2 * fine) + 0.5) / fine - 0.5
    rising = (np.arange(fine) + 0.5) / fine**2
    weights = np.outer(*[np.hstack([rising, rising[::-1]])] * 2).ravel()
    grid = np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2)
    index = on_device(mi.UInt32, np.repeat(np.arange(resolution**2), 4 * fine**2))
    sample = on_device(mi.Point2f, np.tile(grid, (resolution**2, 1)))
    direction, density = direction_in_bin(index, sample, resolution)
    np.testing.assert_allclose(density, bin_density(direction, resolution), rtol=1e-5)
    inverse = (1 / np.array(density, np.float64)).reshape(resolution**2, -1) @ weights
    assert inverse.sum() == pytest.approx(4 * np.pi, rel=2e-3)
    assert inverse == pytest.approx(solid_angles(resolution), rel=2e-2 if resolution == 4 else 5e-3)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_solid_angles(mi, resolution):
    """They sum to the sphere's, and are those of uniform directions, each with a random offset."""
    from lumitree.core.octahedral import bin_of

    angles = solid_angles(resolution)
    assert angles.shape == (resolution**2,)
    assert angles.sum() == pytest.approx(4 * np.pi, rel=1e-12)
    # The map has the symmetry of a square.
    square = angles.reshape(resolution, resolution)
    for other in (square[::-1], square[:, ::-1], square.T):
        assert other == pytest.approx(square, rel=1e-12)
    count = 1 << 20
    _, direction = random_directions(mi, count, 2)
    expected = angles / (4 * np.pi) * count
    offset = on_device(mi.Point2f, np.random.default_rng(3).random((count, 2)) - 0.5)
    bins = np.array(bin_of(direction, resolution, mi.Vector2f(offset)))
    counts = np.bincount(bins, minlength=resolution**2)
    scores = (counts - expected) / np.sqrt(expected)
    # Chi-squared of all bins, about R² ± R √2.
    assert (scores**2).sum() == pytest.approx(resolution**2, abs=5 * np.sqrt(2) * resolution)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_bilinear_weights_are_the_chances_of_random_offsets(mi, resolution):
    from lumitree.core.octahedral import bilinear_bins, bin_of

    directions, _ = random_directions(mi, 200, resolution)
    # Among them the axes, where the map is folded and where its corners meet.
    axes = np.concatenate([np.eye(3), -np.eye(3)])
    directions = np.concatenate([directions, axes + 1e-4])
    bins, weights = bilinear_bins(directions * 7, resolution)
    assert weights.min() >= 0
    np.testing.assert_allclose(weights.sum(axis=1), 1, rtol=1e-12)
    count = 1 << 12
    offset = np.random.default_rng(5).random((count * len(directions), 2)) - 0.5
    repeated = on_device(mi.Vector3f, np.repeat(directions, count, axis=0))
    found = bin_of(repeated, resolution, mi.Vector2f(on_device(mi.Point2f, offset)))
    for row, drawn in enumerate(np.array(found).reshape(-1, count)):
        have = np.bincount(drawn, minlength=resolution**2)
        want = np.bincount(bins[row], weights[row], resolution**2) * count
        # Five standard errors, and rounding on the border of a bin.
        assert (np.abs(have - want) < 5 * np.sqrt(want) + 5).all()


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_interpolated_intensities_have_the_flux_of_the_bins(resolution):
    from lumitree.core.octahedral import bilinear_bins

    values = np.random.default_rng(1).exponential(size=resolution**2)
    index = np.arange(1 << 18) + 0.5
    height, angle = 1 - 2 * index / len(index), np.pi * (1 + 5**0.5) * index
    flat = np.sqrt(1 - height**2)
    lattice = np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=-1)
    bins, weights = bilinear_bins(lattice, resolution)
    flux = 4 * np.pi * (values[bins] * weights).sum(axis=1).mean()
    assert flux == pytest.approx(values @ solid_angles(resolution), rel=2e-3)


def test_a_border_of_the_map_is_what_is_beyond_its_sides():
    from lumitree.core.octahedral import bordered

    values = np.arange(16).reshape(4, 4)
    expected = [
        [15, 3, 2, 1, 0, 12],
        [12, 0, 1, 2, 3, 15],
        [8, 4, 5, 6, 7, 11],
        [4, 8, 9, 10, 11, 7],
        [0, 12, 13, 14, 15, 3],
        [3, 15, 14, 13, 12, 0],
    ]
    found = bordered(values, 1)
    assert found.tolist() == expected
