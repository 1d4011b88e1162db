"""Codebooks of reach: what they keep, and how near they are."""

import numpy as np
import pytest

from lumitree.fit.light_field.inside import codebook


def entries(seed, count, kinds):
    """Light [count, 6] beyond distances, whose ratios are some of a few curves."""
    random = np.random.default_rng(seed)
    curves = -np.sort(-random.random((kinds, 6)), axis=1)
    curves[:, 0] = 1
    light = random.exponential(1, (count, 1))
    return (curves[random.integers(kinds, size=count)] * light).astype(np.float32)


def test_a_few_curves_are_found(mi):
    beyond = entries(0, 5000, 9)
    rows, curves = codebook(beyond, 256, 0)
    assert beyond / beyond[:, :1] == pytest.approx(curves[rows], rel=1e-4)


@pytest.mark.parametrize("count", [500, 40_000])
def test_light_is_kept_by_curve_and_point(count):
    beyond = entries(1, count, count)
    rows, curves = codebook(beyond, 32, 0)
    assert len(curves) <= 32
    for row in range(len(curves)):
        mine = beyond[rows == row]
        assert len(mine)
        kept = curves[row] * mine[:, 0].sum(dtype=np.float64)
        assert kept == pytest.approx(mine.sum(axis=0, dtype=np.float64), rel=1e-4)
    # The most frequent is the first, so that bytes repeat.
    assert (np.diff(np.bincount(rows)) <= 0).all()


def test_more_curves_are_nearer():
    beyond = entries(2, 4000, 4000)
    part = beyond / beyond[:, :1]
    errors = []
    for count in (4, 32, 256):
        rows, curves = codebook(beyond, count, 0)
        errors.append((beyond[:, :1] * (part - curves[rows]) ** 2).mean())
    assert errors[1] < 0.5 * errors[0]
    assert errors[2] < 0.5 * errors[1]


def test_curves_do_not_increase():
    _, curves = codebook(entries(4, 5000, 5000), 256, 0)
    assert (curves[:, 0] == 1).all()
    assert (np.diff(curves, axis=1) <= 0).all()


def test_entries_without_light_get_a_curve_and_change_none():
    beyond = entries(5, 300, 300)
    dark = np.concatenate([np.zeros((7, 6), np.float32), beyond])
    rows, curves = codebook(dark, 16, 0)
    expected = codebook(beyond, 16, 0)
    assert np.array_equal(rows[7:], expected[0])
    assert np.array_equal(curves, expected[1])


@pytest.mark.parametrize("count", [0, 3])
def test_no_light(count):
    rows, curves = codebook(np.zeros((count, 4), np.float32), 8, 0)
    assert rows.tolist() == [0] * count
    assert curves.tolist() == [[1, 0, 0, 0]]


def test_equal_arguments_give_equal_curves():
    beyond = entries(3, 30_000, 600)
    first, second = (codebook(beyond, 64, 5) for _ in range(2))
    assert np.array_equal(first[0], second[0])
    assert np.array_equal(first[1], second[1])
