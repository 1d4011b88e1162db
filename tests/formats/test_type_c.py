"""Angles, grids and intensities of Type C, symmetries of files, and Types A and B."""

import numpy as np
import pytest

from lumitree.core.frames import halton_direction
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.formats.opening import Opening
from lumitree.formats.reading import without_noise
from lumitree.formats.type_c import (
    Grid,
    IntensityDistribution,
    angles_of,
    completed,
    direction_of,
    node_solid_angles,
    on_grid,
    turned_of_type_b,
    type_a,
    y_up,
    z_up,
)

DIRECTIONS = np.array([halton_direction(index) for index in range(1, 400)])


def uniform_directions(count, seed):
    vectors = np.random.default_rng(seed).normal(size=(count, 3))
    return vectors / np.linalg.norm(vectors, axis=1, keepdims=True)


def test_named_directions():
    for c, gamma, direction in (
        (0, 0, [0, -1, 0]),
        (0, 180, [0, 1, 0]),
        (0, 90, [1, 0, 0]),
        # Counter-clockwise seen from above: +x, -z, -x, +z.
        (90, 90, [0, 0, -1]),
        (180, 90, [-1, 0, 0]),
        (270, 90, [0, 0, 1]),
    ):
        assert direction_of(c, gamma) == pytest.approx(np.array(direction), abs=1e-15)


def test_angles_there_and_back():
    c, gamma = angles_of(3.7 * DIRECTIONS)
    assert ((c >= 0) & (c < 360)).all()
    assert ((gamma >= 0) & (gamma <= 180)).all()
    assert direction_of(c, gamma) == pytest.approx(DIRECTIONS, abs=1e-12)
    # A tiny angle below 0 is not 360.
    assert angles_of([1, 0, 1e-20])[0] < 360


def test_frames_with_z_up_are_turned_and_not_mirrored():
    assert z_up([0, 1, 0]).tolist() == [0, 0, 1]
    assert y_up(z_up(DIRECTIONS)).tolist() == DIRECTIONS.tolist()
    first, second = DIRECTIONS[:-1], DIRECTIONS[1:]
    crossed = np.cross(z_up(first), z_up(second))
    assert crossed == pytest.approx(z_up(np.cross(first, second)), abs=1e-12)


def test_solid_angles_of_uneven_nodes_by_quadrature():
    c, gamma = np.array([10.0, 40, 200, 300]), np.array([0.0, 5, 60, 61, 180])
    fine = np.deg2rad((np.arange(400_000) + 0.5) * (180 / 400_000))
    along = [np.interp(np.rad2deg(fine), gamma, row) * np.sin(fine) for row in np.eye(5)]
    heights = np.sum(along, axis=1) * (fine[1] - fine[0])
    widths = np.deg2rad([(30 + 70) / 2, (30 + 160) / 2, (160 + 100) / 2, (100 + 70) / 2])
    assert node_solid_angles(c, gamma) == pytest.approx(np.outer(widths, heights), rel=1e-6)


@pytest.mark.parametrize("step", [0.4, 31, 7, 0, -5, float("nan"), 1e9])
def test_steps_that_do_not_divide_a_right_angle_are_refused(step):
    with pytest.raises(LumitreeError, match="angular step"):
        Grid(step)


def test_intensity_keeps_the_flux_of_each_ray():
    grid, random = Grid(7.5), np.random.default_rng(1)
    flux = random.exponential(size=1000)
    directions = np.concatenate([uniform_directions(994, 2), *(s * np.eye(3) for s in (1, -1))])
    intensity = grid.intensity(directions, flux)
    total = (intensity * node_solid_angles(grid.c, grid.gamma)).sum()
    assert total == pytest.approx(flux.sum())
    # The poles are one direction.
    assert np.ptp(intensity[:, [0, -1]], axis=0) == pytest.approx(0, abs=1e-9)


def test_intensity_of_a_known_distribution_is_unbiased_and_its_variance_is_right():
    """Rays of cosine intensity downwards, in 400 batches: z-values of nodes have variance 1."""
    grid, count, batches = Grid(15), 2000, 400
    random = np.random.default_rng(3)
    estimates, variances = [], []
    for _ in range(batches):
        cosine = np.sqrt(random.random(count))
        azimuth = 2 * np.pi * random.random(count)
        sine = np.sqrt(1 - cosine**2)
        directions = np.stack([sine * np.cos(azimuth), -cosine, sine * np.sin(azimuth)], axis=1)
        flux = np.full(count, np.pi / count)
        estimates.append(grid.intensity(directions, flux))
        variances.append(grid.variance(directions, flux))
    # The mean of the cosine over each hat.
    fine = np.deg2rad((np.arange(90_000) + 0.5) / 1000)
    hats = np.array([np.interp(np.rad2deg(fine), grid.gamma, row) for row in np.eye(13)])
    sphere = np.deg2rad((np.arange(180_000) + 0.5) / 1000)
    whole = np.array([np.interp(np.rad2deg(sphere), grid.gamma, row) for row in np.eye(13)])
    expected = (hats * np.sin(fine) * np.cos(fine)).sum(1) / (whole * np.sin(sphere)).sum(1)
    mean, lit = np.mean(estimates, axis=0), expected > 0
    error = np.std(estimates, axis=0, ddof=1) / np.sqrt(batches)
    z = ((mean - expected) / np.where(error > 0, error, 1))[:, lit]
    assert np.abs(z).max() < 5
    assert 0.7 < (z[:, 1:] ** 2).mean() < 1.4
    assert (mean[:, ~lit] == 0).all()
    ratio = np.mean(variances, axis=0)[:, lit] / np.var(estimates, axis=0, ddof=1)[:, lit]
    # The reference itself has an error of 7 % in each node.
    assert ratio.mean() == pytest.approx(1, abs=0.03)


def random_distribution(seed, planes=8, rows=7):
    random = np.random.default_rng(seed)
    c = np.sort(random.random(planes)) * 359
    gamma = np.concatenate([[0.0], 1 + np.sort(random.random(rows - 2)) * 178, [180.0]])
    return IntensityDistribution("random", c, gamma, random.random((planes, rows)))


@pytest.mark.parametrize("seed", range(5))
def test_interpolation_at_nodes_and_its_flux(seed):
    distribution = random_distribution(seed)
    c, gamma = np.meshgrid(distribution.c, distribution.gamma[1:-1], indexing="ij")
    values = distribution.at(direction_of(c, gamma))
    assert values == pytest.approx(distribution.intensity[:, 1:-1], abs=1e-9)
    # Monte Carlo integral of the interpolated intensity.
    found = 4 * np.pi * distribution.at(uniform_directions(400_000, seed))
    error = found.std() / np.sqrt(found.size)
    assert abs(found.mean() - distribution.lumens) < 4.5 * error
    assert error < 0.01 * distribution.lumens


@pytest.mark.parametrize("value", [-1.0, np.nan, np.inf, 1e16])
def test_unusable_intensities_are_refused(value):
    intensity = np.array([[1.0, value]])
    with pytest.raises(LumitreeError, match="intensities"):
        IntensityDistribution("", np.zeros(1), np.array([0.0, 180]), intensity)


@pytest.mark.parametrize("lumens", [np.nan, np.inf, -np.inf, -1.0])
def test_no_number_that_is_not_finite_reaches_a_file(lumens):
    grid = Grid(30)
    values = np.ones((len(grid.c), len(grid.gamma)))
    with pytest.raises(LumitreeError, match=r"flux of the bare emitters of lamp is -?(nan|inf|1) "):
        IntensityDistribution("lamp", grid.c, grid.gamma, values, emitted_lumens=lumens)
    for wrong in (np.nan, np.inf):
        with pytest.raises(LumitreeError, match="intensities that are NaN"):
            IntensityDistribution("lamp", grid.c, grid.gamma, values * wrong)
        with pytest.raises(LumitreeError, match="the opening is"):
            Opening((wrong, 0.0, 1.0))


@pytest.mark.parametrize(
    ("c", "same"),
    [
        ([0.0], lambda c: 0 * c),
        ([0.0, 30, 90], lambda c: np.minimum(c % 180, 180 - c % 180)),
        ([0.0, 60, 170, 180], lambda c: np.minimum(c, 360 - c)),
        ([0.0, 100, 200, 300, 360], lambda c: c),
        ([0.0, 90, 180, 270], lambda c: c),
        ([90.0, 130, 180, 270], lambda c: np.where((c >= 90) & (c <= 270), c, (180 - c) % 360)),
        ([180.0, 250, 360], lambda c: np.maximum(c, 360 - c)),
        (
            [-90.0, -20, 90],
            lambda c: np.where(np.cos(np.deg2rad(c)) > 0, (c + 90) % 360 - 90, 180 - c),
        ),
        ([270.0, 340, 450], lambda c: np.where(c < 90, c + 360, np.where(c > 270, c, 540 - c))),
    ],
)
def test_symmetries_of_files(c, same):
    """The completed distribution equals the file's at the mirrored angle."""
    gamma = np.array([0.0, 50, 180])
    values = np.random.default_rng(0).random((len(c), 3))
    if c[-1] - c[0] == 360:
        values[-1] = values[0]
    whole = IntensityDistribution("", *completed(np.array(c), gamma, values))
    angles = np.arange(0.5, 360, 7)
    planes = np.append(c, 360.0) if len(c) == 4 and c[0] == 0 else np.array(c)
    rows = np.append(values[:, 1], values[0, 1]) if len(planes) > len(c) else values[:, 1]
    expected = np.interp(same(angles), planes, rows)
    assert whole.at(direction_of(angles, 50.0)) == pytest.approx(expected)


def test_ranges_of_gamma_are_filled_with_darkness():
    values = np.ones((1, 2))
    below = IntensityDistribution("", *completed(np.zeros(1), np.array([0.0, 90]), values))
    above = IntensityDistribution("", *completed(np.zeros(1), np.array([90.0, 180]), values))
    assert below.at([[0, -1, 0], [1, -0.1, 0], [1, 0.1, 0], [0, 1, 0]]).tolist() == [1, 1, 0, 0]
    assert above.at([[0, -1, 0], [1, -0.1, 0], [1, 0.1, 0], [0, 1, 0]]).tolist() == [0, 0, 1, 1]
    assert below.lumens == pytest.approx(2 * np.pi, rel=1e-4)


@pytest.mark.parametrize(
    ("c", "gamma"),
    [
        ([0.0, 120], [0.0, 180]),
        ([90.0, 180], [0.0, 180]),
        ([0.0], [0.0, 190]),
        ([0.0], [-10.0, 90]),
        ([0.0, 400], [0.0, 180]),
        # There are no planes between 270 and 360.
        ([0.0, 30, 60, 90, 120, 150, 180, 210, 240, 270], [0.0, 180]),
    ],
)
def test_other_angles_are_refused(c, gamma):
    with pytest.raises(LumitreeError, match="angles"):
        completed(np.array(c), np.array(gamma), np.ones((len(c), len(gamma))))


def type_b(horizontal, vertical, intensity):
    return on_grid(turned_of_type_b(horizontal, vertical, intensity))


@pytest.mark.parametrize(
    ("horizontal", "vertical"),
    [([0, 200], [-90, 90]), ([-90, 90], [-100, 200]), ([-90, 90, 80], [0, 90]), ([], [0, 90])],
)
def test_other_angles_of_types_a_and_b_are_refused(horizontal, vertical):
    values = np.ones((len(horizontal), len(vertical)))
    for convert in (type_a, type_b):
        with pytest.raises(LumitreeError, match=r"angles|planes"):
            convert(np.array(horizontal, float), np.array(vertical, float), values)


def test_small_negative_intensities_are_noise():
    with pytest.warns(LumitreeWarning, match="a.ies: small negative"):
        values = without_noise("a.ies", np.array([[1000.0, -0.05, 3]]))
    assert values.tolist() == [[1000, 0, 3]]
    with pytest.raises(LumitreeError, match="negative intensity, -2 cd"):
        without_noise("a.ies", np.array([[1000.0, -2.0]]))
