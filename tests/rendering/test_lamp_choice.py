"""The choice of a lamp by what it sends to the receiver."""

import numpy as np
import pytest
from scipy import stats

from lumitree.core.device import on_device
from lumitree.rendering.sampling.lamp_choice import LampChoice, Lamps, make_nodes, tree_shape


def some_lamps(count, seed=0):
    """Lamps of different size and light in a hall."""
    random = np.random.default_rng(seed)
    return Lamps(
        random.uniform([0, 2, 0], [20, 3, 10], (count, 3)),
        random.uniform(0.1, 0.4, count),
        random.exponential(1, (count, 6)) * random.exponential(1, (count, 1)),
    )


def some_receivers(count, seed=1):
    """Points in and around the hall; unit normals, of which some are 0."""
    random = np.random.default_rng(seed)
    x = random.uniform([-1, 0, -1], [21, 4, 11], (count, 3))
    n = random.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    n[::5] = 0
    return x, n


def weights(rows, x, n):
    """w [R, K] of nodes for receivers, as the symbols of the module define it."""
    centre, radius = rows[:, :3], rows[:, 3]
    offset = x[:, None] - centre
    distance = np.linalg.norm(offset, axis=2)
    direction = offset / distance[..., None]
    sides = np.where(direction > 0, rows[:, 4:7], rows[:, 8:11])
    intensity = (direction**2 * sides).sum(axis=2)
    s = np.minimum(radius / distance + 1e-3, 1)
    cosine = ((-direction * n[:, None]).sum(axis=2) + s) / (1 + s)
    cosine = np.clip(np.maximum(cosine, np.where(distance < radius, 0.25, 0)), 0, 1)
    cosine[~n.any(axis=1)] = 1
    return intensity * cosine / np.maximum(distance**2, radius**2 / 4)


def probabilities(lamps, x, n):
    """Probability [R, N] of each lamp, by the tree's definition."""
    rows, row_of = make_nodes(lamps)
    levels, children = tree_shape(len(lamps))
    weight = weights(rows, x, n)
    found = np.ones((len(x), len(lamps)))
    for lamp, row in enumerate(row_of):
        for _ in range(levels):
            first = row - row % children
            total = weight[:, first : first + children].sum(axis=1)
            found[:, lamp] *= np.divide(weight[:, row], total, np.zeros(len(x)), where=total > 0)
            row = row // children - 1
    return found


def sampled(mi, choice, x, n, sample, excluded=None):
    """Indices, probabilities and sums [R]."""
    excluded = np.full(len(x), 0xFFFFFFFF) if excluded is None else excluded
    index, pmf, part, total = choice.sample(
        on_device(mi.Point3f, x),
        on_device(mi.Vector3f, n),
        on_device(mi.UInt32, excluded),
        on_device(mi.Float, sample),
        mi.Bool(True),
    )
    return tuple(np.array(each) for each in (index, pmf, total))


@pytest.mark.parametrize(
    ("count", "shape"), [(1, (1, 1)), (20, (1, 20)), (33, (2, 6)), (200, (2, 15)), (1025, (3, 11))]
)
def test_each_lamp_is_in_one_leaf_and_in_the_spheres_above_it(count, shape):
    lamps = some_lamps(count)
    rows, row_of = make_nodes(lamps)
    levels, children = tree_shape(count)
    assert (levels, children) == shape
    assert len(set(row_of)) == count
    for lamp, row in enumerate(row_of):
        for _ in range(levels):
            distance = np.linalg.norm(rows[row, :3] - lamps.centres[lamp])
            assert distance + lamps.radii[lamp] <= rows[row, 3] * (1 + 1e-12)
            row = row // children - 1
        assert row == -1
    lit = rows[:children, [4, 5, 6, 8, 9, 10]].sum()
    assert lit == pytest.approx(lamps.intensities.sum())


@pytest.mark.parametrize("count", [7, 200])
def test_lamps_are_chosen_with_their_probabilities(mi, count):
    lamps = some_lamps(count)
    choice = LampChoice(lamps, np.arange(count))
    x, n = some_receivers(12)
    expected = probabilities(lamps, x, n)
    # The whole probability, unless all lamps are below the horizon.
    whole = expected.sum(axis=1)
    assert whole == pytest.approx(np.where(whole > 0.5, 1, 0), abs=1e-6)
    samples = 1 << 16
    strata = (np.arange(samples) + 0.5) / samples
    p_values = []
    for place in range(len(x)):
        repeated = (np.repeat(each[place : place + 1], samples, 0) for each in (x, n))
        index, pmf, total = sampled(mi, choice, *repeated, strata)
        if whole[place] < 0.5:
            assert not pmf.any()
            continue
        assert pmf == pytest.approx(expected[place][index], rel=1e-3)
        assert total == pytest.approx(total[0])
        counts = np.bincount(index, minlength=count)
        often = samples * expected[place] > 5
        f = [*counts[often], counts[~often].sum()]
        g = [*samples * expected[place][often], samples * expected[place][~often].sum()]
        f, g = ([a for a, b in zip(each, g, strict=True) if b > 1e-3] for each in (f, g))
        p_values.append(stats.chisquare(f, np.array(g) * sum(f) / sum(g)).pvalue)
    assert len(p_values) > 8
    assert min(p_values) > 1e-3 / len(p_values)


def test_random_samples_have_the_probabilities(mi):
    """χ² with independent random numbers, which strata would make too even."""
    lamps = some_lamps(40)
    choice = LampChoice(lamps, np.arange(40))
    x, n = (np.repeat(each, 1 << 16, 0) for each in some_receivers(1))
    sample = np.random.default_rng(5).random(len(x), np.float32)
    index, _, _ = sampled(mi, choice, x, n, sample)
    expected = len(x) * probabilities(lamps, x[:1], n[:1])[0]
    often = expected > 5
    counts = np.bincount(index, minlength=40)
    assert often.sum() > 10
    p = stats.chisquare(
        [*counts[often], counts[~often].sum()], [*expected[often], expected[~often].sum()]
    ).pvalue
    assert p > 1e-3


@pytest.mark.parametrize("count", [30, 100])
def test_the_part_of_a_lamp_is_its_probability_if_there_is_one_level(mi, count):
    lamps = some_lamps(count)
    choice = LampChoice(lamps, np.arange(count))
    x, n = some_receivers(500)
    index, pmf, total = sampled(mi, choice, x, n, np.random.default_rng(3).random(len(x)))
    part = choice.part(
        on_device(mi.UInt32, index),
        on_device(mi.Point3f, x),
        on_device(mi.Vector3f, n),
        on_device(mi.Float, total),
        on_device(mi.Bool, pmf > 0),
    )
    ratio = np.array(part)[pmf > 0] / pmf[pmf > 0]
    assert ratio == pytest.approx(1, rel=1e-3 if count == 30 else 2)


def test_lamps_that_may_send_light_have_a_probability():
    """Each lamp of which a point is above the horizon, also where nodes are below it."""
    lamps = some_lamps(150, seed=3)
    x, n = some_receivers(2000, seed=4)
    found = probabilities(lamps, x, n)
    above = ((lamps.centres - x[:, None]) * n[:, None]).sum(axis=2) + lamps.radii > 0
    above |= ~n.any(axis=1)[:, None]
    assert 0.3 < above.mean() < 0.9
    assert (found[above] > 0).all()


def test_an_excluded_lamp_and_dark_lamps_are_not_chosen(mi):
    lamps = some_lamps(60)
    lamps.intensities[::2] = 0
    choice = LampChoice(lamps, np.arange(60) + 5)
    x, n = some_receivers(4000)
    excluded = np.random.default_rng(2).integers(5, 65, len(x))
    index, pmf, _ = sampled(mi, choice, x, n, np.random.default_rng(3).random(len(x)), excluded)
    chosen = pmf > 0
    assert chosen.mean() > 0.8
    assert (index[chosen] != excluded[chosen]).all()
    assert ((index[chosen] - 5) % 2 == 1).all()
