"""Alias tables: their probabilities, and that samples have them."""

import numpy as np
import pytest


def rows_of_weights():
    random = np.random.default_rng(3)
    spiky = np.zeros(100)
    spiky[[7, 50, 99]] = 1, 5, 1e-7
    return {
        "random": random.exponential(1, 100),
        "steep": np.geomspace(1, 1e-12, 100),
        "equal": np.full(100, 0.3),
        "spiky": spiky,
    }


@pytest.mark.parametrize("count", [1, 2, 3, 1000])
def test_a_row_of_any_length_has_the_probabilities_of_its_weights(mi, count):
    from lumitree.core.alias_table import AliasTable

    weights = np.random.default_rng(count).exponential(1, count) ** 3
    table = AliasTable.of(weights[None])
    found = table.probability(mi.UInt32(0), mi.UInt32(np.arange(count)))
    # Thresholds have 22 bits or more, and each is rounded up.
    expected = weights / weights.sum()
    assert np.array(found) == pytest.approx(expected, rel=1e-5, abs=2**-21 / count)


def test_samples_have_the_probabilities_that_the_table_states(mi):
    import drjit as dr

    from lumitree.core.alias_table import AliasTable

    weights = np.stack(list(rows_of_weights().values()))
    short = weights[:2, :7]
    table, samples = AliasTable.of(weights, short), 1 << 20
    sample = mi.PCG32(samples, 5).next_float32()
    rows = [(None, *each) for each in enumerate(weights)]
    rows += [
        (mi.UInt32(part), *each) for part in (0, 1) for each in enumerate([weights, short][part])
    ]
    for part, row, weight in rows:
        count = len(weight)
        index, chance = table.sample(mi.UInt32(row), sample, part=part)
        stated = table.probability(mi.UInt32(row), dr.arange(mi.UInt32, count), part=part)
        assert np.array_equal(np.array(chance), np.array(dr.gather(mi.Float, stated, index)))
        stated = np.array(stated, np.float64)
        assert (stated > 0).all()
        assert stated.sum() == pytest.approx(1, abs=1e-5)
        # Thresholds have 25 bits.
        assert stated == pytest.approx(weight / weight.sum(), abs=1e-7)
        found = np.bincount(np.array(index), minlength=count) / samples
        error = np.sqrt(stated * (1 - stated) / samples)
        likely = stated * samples > 20
        assert (np.abs(found - stated) < 5 * error)[likely].all()
        assert found[~likely].sum() * samples < 20 * (~likely).sum() + 1
