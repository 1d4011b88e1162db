"""Codebooks of curves: what they keep, and how near they are."""

import numpy as np
import pytest

from lumitree.fit.light_field.codebook import codebook


def entries(seed, count, kinds):
    """Numerators and denominators [count, 6] whose ratios are some of a few curves."""
    random = np.random.default_rng(seed)
    curves = random.uniform(0, 4, (kinds, 6))
    d = (random.exponential(1, (count, 1)) * random.uniform(0.5, 1, (count, 6))).astype(np.float32)
    kind = random.integers(kinds, size=count)
    return (curves[kind] * d).astype(np.float32), d


def test_a_few_curves_are_found(mi):
    n, d = entries(0, 5000, 9)
    rows, curves = codebook(n, d, 256, 8.0, 0)
    assert n / d == pytest.approx(curves[rows], rel=1e-4)


@pytest.mark.parametrize("count", [500, 40_000])
def test_light_is_kept_by_curve_and_point(count):
    random = np.random.default_rng(1)
    d = random.exponential(1, (count, 6)).astype(np.float32)
    n = (d * random.uniform(0, 3, (count, 6))).astype(np.float32)
    rows, curves = codebook(n, d, 32, 8.0, 0)
    assert len(curves) <= 32
    for row in range(len(curves)):
        mine = rows == row
        assert mine.any()
        assert (curves[row] * d[mine]).sum(axis=0) == pytest.approx(n[mine].sum(axis=0), rel=1e-4)
    # The most frequent is the first, so that bytes repeat.
    assert (np.diff(np.bincount(rows)) <= 0).all()


def test_more_curves_are_nearer():
    random = np.random.default_rng(2)
    d = np.ones((4000, 6), np.float32)
    n = np.sort(random.random((4000, 6)), axis=1).astype(np.float32)
    errors = []
    for count in (4, 32, 256):
        rows, curves = codebook(n, d, count, 1.0, 0)
        errors.append(((n - curves[rows]) ** 2).mean())
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.5 * errors[1]


def test_ratios_are_cut_and_points_without_weight_hold():
    n = np.array([[1, 9, 0, 0], [1, 9, 0, 0]], np.float32)
    d = np.array([[1, 1, 0, 0], [1, 1, 0, 0]], np.float32)
    rows, curves = codebook(n, d, 4, 8.0, 0)
    assert curves[rows[0]].tolist() == [1, 8, 8, 8]
    # Light that no denominator can weigh gets the largest.
    _, curves = codebook(n, np.zeros_like(d), 4, 8.0, 0)
    assert curves.tolist() == [[8, 8, 8, 8]]
    _, curves = codebook(np.zeros_like(n), np.zeros_like(d), 4, 8.0, 0)
    assert curves.tolist() == [[1, 1, 1, 1]]


def test_no_entries():
    rows, curves = codebook(np.zeros((0, 4), np.float32), np.zeros((0, 4), np.float32), 8, 8.0, 0)
    assert rows.shape == (0,)
    assert curves.tolist() == [[1, 1, 1, 1]]


def test_equal_arguments_give_equal_curves():
    n, d = entries(3, 30_000, 600)
    first, second = (codebook(n, d, 64, 8.0, 5) for _ in range(2))
    assert np.array_equal(first[0], second[0])
    assert np.array_equal(first[1], second[1])
