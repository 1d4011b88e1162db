"""Ways to store a field give it back, in fewer bytes."""

import numpy as np
import pytest

from benchmarks import field_size
from benchmarks.field_size import BASELINE, OURS, WAYS, by_vectors, table
from lumitree.asset.file import as_stored
from support.fields import random_asset


@pytest.fixture(scope="module")
def stored(mi):
    asset = random_asset(0, tree_depth=5)
    return asset, {way: store(asset, 0) for way, store in WAYS.items()}


def test_every_way_gives_the_field_back(stored):
    asset, ways = stored
    for way, each in ways.items():
        found = each.read()
        assert found.coefficients.shape == asset.coefficients.shape, way
        error = found.coefficients.astype(float) - asset.coefficients
        # The steps are at most 1, and the coefficients have a standard deviation of 1.
        assert np.sqrt((error**2).mean()) < 0.6, way
        assert np.allclose(found.density, asset.density, rtol=1 / 16), way


def test_the_file_is_one_of_them(stored):
    asset, ways = stored
    found, expected = ways[OURS].read(), as_stored(asset)
    for name in ("children", "density", "coefficients"):
        assert np.array_equal(getattr(found, name), getattr(expected, name))
    assert ways[OURS].size < ways["zlib"].size < ways[BASELINE].size


def test_more_stages_of_vectors_are_nearer(stored, monkeypatch):
    asset, _ = stored
    # Fewer than leaves, which else have a vector each.
    monkeypatch.setattr(field_size, "_CODES", 32)
    errors = [
        np.square(
            by_vectors(asset, stages, 0).read().coefficients.astype(float) - asset.coefficients
        ).mean()
        for stages in (1, 2, 3)
    ]
    assert errors[0] > errors[1] > errors[2] > 0


def test_rows_are_lines(stored):
    row = {
        "luminaire": "bulbs", "quality": "standard", "leaves": 1000, "way": OURS, "bytes": 5000,
        "load_seconds": 0.25, "metrics": {"psnr_linear": 30.0, "psnr_mulaw": 20.0},
        "irradiance_change": 0.01,
    }  # fmt: skip
    assert "| bulbs, standard | 1,000 |" in table([row]).markdown()
    assert "5.0" in table([row]).text()
