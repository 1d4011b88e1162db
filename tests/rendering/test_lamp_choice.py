"""The choice of a lamp by what it sends to the receiver."""

import dataclasses

import numpy as np
import pytest
from scipy import stats

from lumitree.core.device import on_device
from lumitree.rendering.lamps import NO_LAMP, LampChoice, LampChoices, Lamps

LOW, HIGH = np.zeros(3), np.array([20.0, 4.0, 10.0])


def some_lamps(count, seed=0):
    """Lamps of different size and light in a hall."""
    random = np.random.default_rng(seed)
    return Lamps(
        3 * np.arange(count) + 2,
        random.uniform([0, 2, 0], [20, 3, 10], (count, 3)),
        random.uniform(0.1, 0.4, count),
        random.exponential(1, (count, 6)) * random.exponential(1, (count, 1)),
        LOW,
        HIGH,
    )


def some_receivers(count, seed=1):
    """Points in and around the hall; unit normals, of which some are 0."""
    random = np.random.default_rng(seed)
    x = random.uniform([-1, 0, -1], [21, 4, 11], (count, 3))
    n = random.normal(size=(count, 3))
    n /= np.linalg.norm(n, axis=1)[:, None]
    n[::5] = 0
    return x, n


def estimates(lamps, x, n):
    """w [R, N] of lamps for receivers, as the symbols of the module define it."""
    offset = x[:, None] - lamps.centres
    distance = np.linalg.norm(offset, axis=2)
    direction = offset / distance[..., None]
    even = 0.1 * lamps.intensities.mean(axis=1)[:, None]
    intensities = 0.9 * lamps.intensities + even
    sides = np.where(direction > 0, intensities[:, :3], intensities[:, 3:])
    intensity = (direction**2 * sides).sum(axis=2)
    s = np.minimum(lamps.radii / distance + 1e-3, 1)
    cosine = ((-direction * n[:, None]).sum(axis=2) + s) / (1 + s)
    cosine[~n.any(axis=1)] = 1
    cosine = np.maximum(cosine, np.where(distance < lamps.radii, 0.25, 0))
    return intensity * cosine / np.maximum(distance**2, lamps.radii**2 / 4)


def sampled(mi, choice, x, n, sample, excluded=NO_LAMP):
    """Indices, factors and p [R]."""
    found = choice.sample(
        on_device(mi.Point3f, x),
        on_device(mi.Vector3f, n),
        on_device(mi.UInt32, np.broadcast_to(excluded, len(x))),
        on_device(mi.Point2f, sample),
        mi.Bool(True),
    )
    return tuple(np.array(each) for each in found)


@pytest.mark.parametrize("count", [2, 20, 200])
def test_chosen_lamps_count_for_all(mi, count):
    """The mean of f times the factor is Σ f, for the estimate and for another f."""
    lamps, samples = some_lamps(count), 1 << 13
    choice = LampChoice(lamps)
    x, n = some_receivers(20)
    w = estimates(lamps, x, n)
    random = np.random.default_rng(3)
    p_values, moments = [], []
    for place in range(len(x)):
        repeated = (np.repeat(each[place : place + 1], samples, 0) for each in (x, n))
        index, factor, _ = sampled(mi, choice, *repeated, random.random((samples, 2)))
        if not w[place].any():
            assert not factor.any()
            continue
        lit = factor > 0
        other = w[place] * random.uniform(0, 2, count)
        for f in (w[place], other):
            found = np.where(lit, f[(np.maximum(index, 2) - 2) // 3] * factor, 0)
            z = (found.mean() - f.sum()) / max(found.std() / samples**0.5, 1e-4 * f.sum())
            p_values.append(2 * stats.norm.sf(abs(z)))
            moments.append((found**2).mean() / f.sum() ** 2)
    assert len(p_values) > 25
    assert min(p_values) > 1e-3 / len(p_values)
    # A uniform choice has as many times the light of the brightest lamp.
    assert np.median(moments) < 2


@pytest.mark.parametrize("count", [7, 200])
def test_probabilities_of_the_table_sum_to_one(mi, count):
    lamps = some_lamps(count)
    choice = LampChoice(lamps)
    x, _ = some_receivers(50)
    pairs = np.repeat(x, count, 0)
    index = np.tile(lamps.indices, len(x))
    pmf = choice.pmf(on_device(mi.UInt32, index), on_device(mi.Point3f, pairs), mi.Bool(True))
    pmf = np.array(pmf).reshape(len(x), count)
    assert pmf.sum(axis=1) == pytest.approx(1, rel=1e-5)
    assert pmf.min() > 0
    # In the middle of the hall, about the estimate without a cosine.
    middle = np.array([[10.0, 1.0, 5.0]])
    pmf = choice.pmf(
        on_device(mi.UInt32, lamps.indices), mi.Point3f(*middle[0].tolist()), mi.Bool(True)
    )
    w = estimates(lamps, middle, np.zeros((1, 3)))[0]
    assert np.array(pmf) == pytest.approx(w / w.sum(), rel=0.6)
    none = on_device(mi.UInt32, np.array([0, 1, 3, NO_LAMP]))
    assert not np.array(choice.pmf(none, mi.Point3f(10, 1, 5), mi.Bool(True))).any()


def test_candidates_have_the_probabilities_of_the_table(mi, monkeypatch):
    """χ² of the lamps that are chosen where there is one candidate."""
    from lumitree.rendering import lamps

    monkeypatch.setattr(lamps, "_CANDIDATES", 1)
    lamps, samples = some_lamps(40), 1 << 16
    choice = LampChoice(lamps)
    x = np.full((samples, 3), [7.0, 0.5, 3.0])
    sample = np.random.default_rng(5).random((samples, 2))
    index, factor, pmf = sampled(mi, choice, x, np.zeros((samples, 3)), sample)
    assert factor == pytest.approx(1 / pmf, rel=1e-4)
    expected = np.zeros(40)
    expected[(index - 2) // 3] = samples * pmf
    assert expected.sum() == pytest.approx(samples, rel=0.01)
    counts = np.bincount((index - 2) // 3, minlength=40)
    often = expected > 5
    assert stats.chisquare(counts[often], expected[often] * counts[often].sum()
                           / expected[often].sum()).pvalue > 1e-3  # fmt: skip


def test_lamps_that_may_send_light_have_an_estimate():
    """Each lamp of which a point is above the horizon."""
    lamps = some_lamps(150, seed=3)
    x, n = some_receivers(2000, seed=4)
    above = ((lamps.centres - x[:, None]) * n[:, None]).sum(axis=2) + lamps.radii > 0
    above |= ~n.any(axis=1)[:, None]
    assert 0.3 < above.mean() < 0.9
    assert (estimates(lamps, x, n)[above] > 0).all()


def test_an_excluded_lamp_and_dark_lamps_are_not_chosen(mi):
    lamps = some_lamps(60)
    lamps.intensities[::2] = 0
    x, n = some_receivers(4000)
    random = np.random.default_rng(2)
    excluded = random.choice(lamps.indices, len(x))
    index, factor, _ = sampled(mi, LampChoice(lamps), x, n, random.random((len(x), 2)), excluded)
    chosen = factor > 0
    assert chosen.mean() > 0.7
    assert (index[chosen] != excluded[chosen]).all()
    assert ((index[chosen] - 2) // 3 % 2 == 1).all()


def test_lamps_without_light_are_accepted(mi):
    lamps = some_lamps(3)
    lamps.intensities[:] = 0
    x, n = some_receivers(100)
    _, factor, _ = sampled(mi, LampChoice(lamps), x, n, np.full((100, 2), 0.5))
    assert not factor.any()


def test_tables_are_made_again_when_lamps_change(mi):
    choices, lamps = LampChoices(), some_lamps(5)
    first = choices.of(lamps)
    assert choices.of(some_lamps(5)) is first
    assert choices.of(dataclasses.replace(lamps, radii=2 * lamps.radii)) is not first
