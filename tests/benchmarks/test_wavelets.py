"""A light field on the box by its wavelets: the transform, its compression, and its samples."""

import math

import numpy as np
import pytest
from scipy import stats

from benchmarks.baselines import wavelet_tree

pytest.importorskip("pywt", reason="PyWavelets is not installed; the extra `dev` has it")

HALF = np.array([1.0, 0.75, 0.5])
SIZES = [(4, 4), (4, 8), (8, 8)]


def light(positions, directions, seed=0):
    """Flux of cells: most have none, some little, and a few much."""
    random = np.random.default_rng(seed)
    shape = (6, positions, positions, directions, directions)
    flux = random.random(shape) + 50 * (random.random(shape) < 0.01)
    flux[random.random(shape) < 0.6] = 0
    return flux[..., None] * random.random((6, 1, 1, 1, 1, 3))


def levels_of(flux):
    return int(math.log2(min(flux.shape[1], flux.shape[3])))


def expanded(tree, flux, level):
    """Mean flux [N, 3] of the cells in each part of a level; rows are in the tree's order."""
    slots = np.arange(flux[..., 0].size // 16 ** levels_of(flux))
    for _ in range(level):
        first = tree.first[slots].astype(np.int64)[:, None]
        slots = np.where(first > 0, first + np.arange(16), slots[:, None]).ravel()
    return tree.values[slots]


def compressed(flux, num_bytes):
    return wavelet_tree.compress(wavelet_tree.transform(flux), num_bytes)


def linear(flux, fraction):
    """Sum [N, 3] of the largest wavelets of a light field, with what is negative."""
    import pywt

    made = wavelet_tree.transform(flux)
    sizes = np.concatenate([np.linalg.norm(each, axis=-1).ravel() for each in made.details])
    limit = np.quantile(sizes, 1 - fraction)
    scaling, *bands = pywt.wavedecn(flux, "haar", axes=(1, 2, 3, 4), level=levels_of(flux))
    for each in bands:
        for values in each.values():
            values[np.linalg.norm(values, axis=-1) <= limit] = 0
    return pywt.waverecn([scaling, *bands], "haar", axes=(1, 2, 3, 4))


@pytest.mark.parametrize(("positions", "directions"), SIZES)
def test_sixteen_rows_are_the_children_of_one(positions, directions):
    flux = light(positions, directions)
    level = levels_of(flux)
    rows = wavelet_tree.nested(flux, level)
    for coarser in range(level - 1, -1, -1):
        flux = sum(
            flux[:, i::2, j::2, k::2, m::2]
            for i in (0, 1)
            for j in (0, 1)
            for k in (0, 1)
            for m in (0, 1)
        )
        rows = rows.reshape(-1, 16, 3).sum(axis=1)
        np.testing.assert_allclose(rows, wavelet_tree.nested(flux, coarser), rtol=1e-12)


@pytest.mark.parametrize(("positions", "directions"), SIZES)
def test_all_coefficients_give_the_light_field_back(positions, directions):
    flux = light(positions, directions)
    found = expanded(compressed(flux, math.inf), flux, levels_of(flux))
    expected = wavelet_tree.nested(flux, levels_of(flux))
    np.testing.assert_allclose(found, expected, atol=1e-12 * flux.max())


@pytest.mark.parametrize(("positions", "directions"), SIZES)
def test_a_budget_is_kept_and_more_bytes_give_a_smaller_error(positions, directions):
    flux = light(positions, directions)
    expected = wavelet_tree.nested(flux, levels_of(flux))
    whole = compressed(flux, math.inf).num_bytes
    errors = []
    for share in (0.03, 0.1, 0.3, 1.0):
        tree = compressed(flux, share * whole)
        assert 0.95 * share * whole - 100 <= tree.num_bytes <= share * whole
        found = expanded(tree, flux, levels_of(flux))
        errors.append(np.sqrt(np.mean((found - expected) ** 2) / np.mean(expected**2)))
    assert (np.diff(errors) < 0).all()
    # All coefficients, rounded to 9 bits of the largest channel.
    assert 0 < errors[-1] < 2**-8


def test_dropped_coefficients_make_no_light_negative_and_move_none_out_of_its_part():
    flux = light(8, 16)
    kept = linear(flux, 0.05)
    assert kept.min() < -0.01 * flux.max()
    tree = compressed(flux, 0.1 * compressed(flux, math.inf).num_bytes)
    assert tree.values.min() == 0
    levels = levels_of(flux)
    finest = expanded(tree, flux, levels)
    for level in range(levels + 1):
        sums = finest.reshape(-1, 16 ** (levels - level), 3).mean(axis=1)
        np.testing.assert_allclose(expanded(tree, flux, level), sums, rtol=1e-9, atol=1e-12)
    parts = wavelet_tree.nested(flux, levels).reshape(-1, 16**levels, 3).mean(axis=1)
    np.testing.assert_allclose(expanded(tree, flux, 0), parts, rtol=1e-12)


def test_where_nothing_is_negative_it_is_the_sum_of_the_wavelets_kept():
    random = np.random.default_rng(3)
    flux = 1 + 0.1 * random.random((6, 4, 4, 4, 4, 3))
    made = wavelet_tree.transform(flux)
    count = sum(each[..., 0].size for each in made.details)
    # 4 bytes a coefficient and a node, and 12 a part: about half of the coefficients.
    tree = wavelet_tree.compress(made, 72 + 4 * (count // 2) + 4 * count // 15)
    kept = (tree.num_bytes - 72 - 4 * sum(len(each) for each in made.details)) // 4
    found = expanded(tree, flux, 2)
    np.testing.assert_allclose(
        found, wavelet_tree.nested(linear(flux, kept / count), 2), atol=2**-8 * 0.5
    )


def test_no_light_is_no_light():
    flux = np.zeros((6, 4, 4, 4, 4, 3))
    tree = compressed(flux, 1000)
    assert tree.num_bytes == 72
    assert not tree.values.any()


@pytest.mark.parametrize("width", [0, 0.5, 2])
def test_the_filter_keeps_the_flux_of_each_face(mi, width):
    from benchmarks.baselines.wavelets import filtered

    flux = light(4, 8)
    axes = (1, 2, 3, 4)
    smooth = filtered(flux, width)
    np.testing.assert_allclose(smooth.sum(axis=axes), flux.sum(axis=axes), rtol=1e-9)
    assert (smooth.std() < flux.std()) == (width > 0)


def test_cells_are_where_light_leaves_and_have_equal_solid_angles(mi):
    import drjit as dr

    from benchmarks.baselines.wavelets import BoxCells

    cells, count = BoxCells(HALF, 4, 8), 1 << 20
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(1, count)
    face = mi.UInt32(6 * sampler.next_1d())
    place = sampler.next_2d()
    local = mi.warp.square_to_uniform_hemisphere(sampler.next_2d())
    point, direction = cells.point(face, place), cells.by_axes(face, local)
    outside = np.abs(np.array(point).T) / HALF
    np.testing.assert_allclose(outside.max(axis=1), 1, rtol=1e-6)
    assert dr.all(dr.norm(cells.by_sides(face, direction) - local) < 1e-6)
    # Along the line, from inside or from either side of the box.
    for offset in (-0.01, 3, -9):
        found, where, same, hit = cells.leaving(point + offset * direction, direction)
        near = (found == face) & hit & (dr.norm(where - place) < 1e-3)
        assert np.mean(np.array(near)) > 0.999
        assert dr.mean(dr.norm(same - local)) < 1e-3
    index = np.ravel_multi_index(
        [np.array(each).astype(int) for each in cells.cell(place, local)], cells.shape[1:]
    )
    assert stats.chisquare(np.bincount(index, minlength=4**2 * 8**2)).pvalue > 1e-4
    x = mi.Point3f(0.9, -2, 0)
    seen = [cells.visible(x, axis) for axis in range(3)]
    assert [int(number[0]) for number, _ in seen] == [1, 2, 4]
    assert [bool(is_seen[0]) for _, is_seen in seen] == [False, True, False]


@pytest.mark.parametrize("share", [0.05, 0.5])
@pytest.mark.parametrize(("positions", "directions"), SIZES)
def test_samples_have_the_distribution_of_the_light_field(mi, positions, directions, share):
    from benchmarks.baselines.wavelets import BoxCells, WaveletLight

    flux, cells, count = (
        light(positions, directions),
        BoxCells(HALF, positions, directions),
        1 << 20,
    )
    num_bytes = share * compressed(flux, math.inf).num_bytes
    made = WaveletLight(flux, cells, num_bytes)
    drawn = made.draw(count, 7)
    inside = drawn.origin - 0.001 * drawn.direction
    face, place, local, _ = cells.leaving(inside, drawn.direction)
    index = [np.array(each).astype(int) for each in (face, *cells.cell(place, local))]
    number = np.arange(np.prod(cells.shape)).reshape(*cells.shape, 1)
    levels = levels_of(flux)
    row = np.empty(number.size, int)
    row[wavelet_tree.nested(number, levels).ravel()] = np.arange(number.size)
    row = row[np.ravel_multi_index(index, cells.shape)]
    values = expanded(compressed(flux, num_bytes), flux, levels)
    expected = values.sum(axis=1) / values.sum() * count
    found = np.bincount(row, minlength=len(expected))
    # Rounding counts some at the borders of cells to a neighbour.
    assert found[expected == 0].sum() < 1e-4 * count
    shown = expected > 5
    merged = [np.append(each[shown], each[~shown].sum()) for each in (found, expected)]
    statistic = ((merged[0] - merged[1]) ** 2 / np.maximum(merged[1], 1)).sum()
    assert stats.chi2.sf(statistic, len(merged[0]) - 1) > 1e-4
    # The sum of a draw is the flux of the rays that it was made of, whatever was dropped.
    total = np.array(drawn.flux, np.float64)
    error = total.std(axis=1) * math.sqrt(count)
    assert (np.abs(total.sum(axis=1) - flux.sum(axis=(0, 1, 2, 3, 4))) < 5 * error).all()
    # Where a ray leaves, its line shows the radiance of its cell.
    radiance = np.array(made.eval(drawn.origin + 2 * drawn.direction, drawn.direction)).T
    area = np.array(cells.area(face)) / positions**2 * np.array(local.z)
    wanted = values[row] / (area * cells.solid_angle)[:, None]
    assert np.mean(np.isclose(radiance, wanted, rtol=1e-3).all(axis=1)) > 0.999
