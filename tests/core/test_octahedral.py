"""Bins of directions: each direction has one, and directions in a bin have the stated density."""

import numpy as np
import pytest

from lumitree.core.device import on_device
from lumitree.core.octahedral import (
    bilinear_bins,
    bin_solid_angles,
    coarse_solid_angles,
    intensity_of_histogram,
    middle_directions,
    parts_of_bins,
    solid_angles,
)

RESOLUTIONS = (4, 16, 64)


def random_directions(mi, count, seed):
    """Directions [count, 3], uniform on the sphere."""
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    vectors /= np.linalg.norm(vectors, axis=1, keepdims=True)
    return vectors, on_device(mi.Vector3f, vectors)


@pytest.mark.parametrize("bevelled", [False, True])
@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_directions_in_a_bin_are_found_in_it(mi, resolution, bevelled):
    import drjit as dr

    from lumitree.core.octahedral import bin_of, direction_in_bin

    repeats = 64
    bins = np.tile(np.arange(resolution**2), repeats)
    # Rounding moves a direction on the border of a bin into the next one.
    samples = 0.001 + 0.998 * np.random.default_rng(resolution).random((len(bins), 2))
    index = on_device(mi.UInt32, bins)
    places = on_device(mi.Point2f, samples)
    direction, density = direction_in_bin(index, places, resolution, bevelled=bevelled)
    np.testing.assert_allclose(dr.norm(direction), 1, atol=1e-6)
    assert np.array_equal(bin_of(direction, resolution, bevelled=bevelled), bins)
    # A direction may have any length.
    assert np.array_equal(bin_of(1000 * direction, resolution, bevelled=bevelled), bins)
    assert np.array(density).min() > 0


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
    from lumitree.core.octahedral import bin_of

    count = 1 << 20
    _, direction = random_directions(mi, count, 1)
    # Area on the octahedron and solid angle differ by the cube of the distance from the origin.
    density = (resolution**2 / 4) / np.abs(np.array(direction, np.float64)).sum(axis=0) ** 3
    bins = np.array(bin_of(direction, resolution, bevelled=False))
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
    from lumitree.core.octahedral import direction_in_bin

    fine = 16
    places = (np.arange(2 * fine) + 0.5) / fine - 0.5
    rising = (np.arange(fine) + 0.5) / fine**2
    weights = np.outer(*[np.hstack([rising, rising[::-1]])] * 2).ravel()
    grid = np.stack(np.meshgrid(places, places), axis=-1).reshape(-1, 2)
    index = on_device(mi.UInt32, np.repeat(np.arange(resolution**2), 4 * fine**2))
    sample = on_device(mi.Point2f, np.tile(grid, (resolution**2, 1)))
    _, density = direction_in_bin(index, sample, resolution)
    inverse = (1 / np.array(density, np.float64)).reshape(resolution**2, -1) @ weights
    assert inverse.sum() == pytest.approx(4 * np.pi, rel=2e-3)
    assert inverse == pytest.approx(solid_angles(resolution), rel=2e-2 if resolution == 4 else 5e-3)


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_solid_angles(mi, resolution):
    """They sum to 4π; uniform directions fall into each bin in proportion to its solid angle."""
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
def test_solid_angles_of_the_directions_of_bins(mi, resolution):
    """Uniform directions fall into single bins, and into groups of four, in proportion to them."""
    from lumitree.core.octahedral import bin_of, coarse_bin

    count = 1 << 20
    _, direction = random_directions(mi, count, 4)
    bins = bin_of(direction, resolution)
    for found, angles in (
        (bins, bin_solid_angles(resolution)),
        (coarse_bin(bins, resolution), coarse_solid_angles(resolution)),
    ):
        assert angles.sum() == pytest.approx(4 * np.pi, rel=1e-12)
        expected = angles / (4 * np.pi) * count
        scores = (np.bincount(np.array(found), minlength=len(angles)) - expected) / np.sqrt(
            expected
        )
        assert (scores**2).sum() == pytest.approx(len(angles), abs=5 * np.sqrt(2 * len(angles)))


def test_directions_that_are_uniform_on_the_map_are_found_where_they_are_from(mi):
    """The slower function finds the place on the map of each direction, for many places."""
    from lumitree.core.octahedral import octahedral

    resolution, parts = 8, 6
    directions, solid_angle = parts_of_bins(resolution, parts)
    centres = (np.arange(resolution * parts) + 0.5) * (2 / (resolution * parts)) - 1
    expected = np.stack(np.meshgrid(centres, centres), axis=-1)
    found = np.array(octahedral(on_device(mi.Vector3f, directions.reshape(-1, 3)), resolution)).T
    # Half a bin at each of ±x and ±y is empty.
    empty = solid_angle.ravel() == 0
    assert empty.sum() == 4 * parts**2 / 2
    difference = np.abs(found - expected.reshape(-1, 2))
    assert difference[~empty].max() < 1e-5


def test_bevels_leave_the_middles_of_bins_where_they_are(mi):
    from lumitree.core.octahedral import direction_in_bin

    index = on_device(mi.UInt32, np.arange(256))
    middle, _ = direction_in_bin(index, mi.Point2f(0.5), 16, bevelled=False)
    np.testing.assert_allclose(np.array(middle).T, middle_directions(16), atol=1e-6)


def smooth_light(directions):
    """Intensity with a slope across all coordinate planes; the largest is 1."""
    axis = np.array([0.3, -0.8, 0.5]) / np.sqrt(0.98)
    return ((1 + directions @ axis) / 2) ** 3


@pytest.mark.parametrize("axis", range(3))
def test_interpolation_is_as_exact_in_coordinate_planes_as_beside_them(axis):
    """Its error falls with the square of the width of bins; with kinks it would with the width."""
    angle = np.linspace(0, 2 * np.pi, 1001)
    directions = np.insert(np.stack([np.cos(angle), np.sin(angle)], axis=-1), axis, 1e-9, axis=1)
    exact, errors = smooth_light(directions), []
    for resolution in (32, 64, 128):
        values = smooth_light(middle_directions(resolution))
        bins, weights = bilinear_bins(directions, resolution)
        errors.append(np.abs((values[bins] * weights).sum(axis=1) - exact).max())
    assert errors[0] > 3 * errors[1] > 9 * errors[2]
    assert errors[1] < 2e-3


def test_even_light_has_even_intensities_and_light_keeps_its_flux():
    flux = np.stack([bin_solid_angles(32), np.arange(1024.0)], axis=-1)[None]
    flux = np.concatenate([flux, np.zeros((1, 1024, 1))], axis=-1)
    intensity = intensity_of_histogram(flux)
    np.testing.assert_allclose(intensity[..., 0], 1, rtol=1e-12)
    found = np.einsum("cbk,b->k", intensity, solid_angles(32))
    np.testing.assert_allclose(found, flux.sum(axis=(0, 1)), rtol=1e-12)
    assert (intensity[..., 2] == 0).all()


@pytest.mark.parametrize("resolution", RESOLUTIONS)
def test_bilinear_weights_are_the_chances_of_random_offsets(mi, resolution):
    from lumitree.core.octahedral import bin_of

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
