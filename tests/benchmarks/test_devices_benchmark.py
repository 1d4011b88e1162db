"""Rows of several variants, and what their images differ by."""

import numpy as np
import pytest

from benchmarks.devices import LAMPS, TILES, difference, table, tiles


def row(variant, seconds, offset, rng):
    means = 1 + 0.01 * rng.random((2, TILES, TILES, 3))
    means[0] *= 1 + offset
    return {
        "setting": {"variant": variant},
        "bake": {which: {"trace": seconds, "fit": seconds} for which in ("first", "again")},
        "images": {
            name: {"first": 2 * seconds, "again": seconds, "tiles": means.tolist()}
            for name in LAMPS
        },
    }


def test_tiles_are_means():
    rng = np.random.default_rng(0)
    image = rng.random((2 * TILES, 3 * TILES, 3)).astype(np.float32)
    found = tiles(image)
    assert found.shape == (TILES, TILES, 3)
    np.testing.assert_allclose(found[1, 2], image[2:4, 6:9].mean(axis=(0, 1)), rtol=1e-6)
    np.testing.assert_allclose(found.mean(), image.mean(), rtol=1e-6)


def test_a_difference_is_relative_to_the_baseline():
    here, there = (row("", 1, offset, np.random.default_rng(0)) for offset in (0.05, 0.0))
    assert difference(there, there, "baked")[0] == 0
    assert difference(here, there, "baked")[0] == pytest.approx(0.05, rel=0.02)


def test_the_first_row_is_the_baseline():
    rng = np.random.default_rng(0)
    text = table([row("slow", 8.0, 0, rng), row("fast", 2.0, 0, rng)]).text()
    slow, fast = text.splitlines()[-2:]
    assert slow.split()[:4] == ["slow", "16.0", "16.0", "1.0"]
    assert fast.split()[:4] == ["fast", "4.0", "4.0", "4.0"]
