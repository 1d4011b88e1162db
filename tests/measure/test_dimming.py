"""Dim levels: against a search of all levels, and what the messages say."""

import dataclasses
import itertools

import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.measure.dimming import Dimmers, Task, TaskPlane, best_step, dim_levels, equal_level


def task(seed=0, lamps=3, points=30, fixed=20.0, error=0.0, **needed):
    """A plane whose points are each lit by some of the lamps."""
    random = np.random.default_rng(seed)
    light = 300 * random.random((points, lamps)) ** 3 + 5
    plane = TaskPlane((0, 0, 0), **needed)
    every = np.arange(points), np.full(points, fixed), light, (error * light) ** 2
    return Task("desk", plane, *every)


def dimmers(lamps=3, **options):
    return Dimmers(np.arange(lamps), np.linspace(1000, 1400, lamps), **options)


def fulfils(each, levels, slack=1e-6):
    lux = each.lux(levels)
    plane = each.plane
    enough = lux.mean() >= plane.target - slack
    even = lux.min() >= plane.uniformity * lux.mean() - slack and lux.min() >= plane.minimum - slack
    return enough and even and (plane.maximum is None or lux.max() <= plane.maximum + slack)


@pytest.mark.parametrize("seed", range(4))
def test_levels_in_steps_are_the_cheapest_of_all(seed):
    each = task(seed, target=120, uniformity=0.2, maximum=550)
    given = dimmers(steps=10)
    levels = dim_levels([each], given, 0.0)
    assert fulfils(each, levels)
    assert np.allclose(10 * levels, np.round(10 * levels))
    every = (np.array(found) / 10 for found in itertools.product(range(11), repeat=3))
    cheapest = min(given.cost @ found for found in every if fulfils(each, found))
    assert given.cost @ levels == pytest.approx(cheapest, rel=3e-3)
    smooth = dim_levels([each], dimmers(), 0.0)
    assert fulfils(each, smooth, 1e-4)
    assert given.cost @ smooth < given.cost @ levels + 1e-6


def test_lamps_of_a_group_have_one_level():
    each = task(target=140)
    grouped = Dimmers(np.array([0, 1, 0]), np.ones(3))
    levels = dim_levels([each], grouped, 0.0)
    assert levels[0] == levels[2] != levels[1]


def test_one_level_for_all_has_the_same_minimum():
    each = dataclasses.replace(task(minimum=30), fixed=np.linspace(0, 40, 30))
    levels = dim_levels([each], dimmers(), 0.0)
    equal = equal_level([each], levels)
    assert each.lux(np.full(3, equal)).min() == pytest.approx(each.lux(levels).min())
    assert dimmers().cost @ levels < equal * dimmers().cost.sum()


def test_points_keep_the_margin_from_their_limits():
    """The illuminance of which the noise is known: with a margin the truth has enough."""
    truth, short = task(7, lamps=6, points=400, minimum=60), {0.0: 0, 2.0: 0}
    random = np.random.default_rng(1)
    for _ in range(20):
        light = truth.lamps * (1 + 0.05 * random.standard_normal(truth.lamps.shape))
        seen = dataclasses.replace(truth, lamps=light, variance=(0.05 * light) ** 2)
        for margin in short:
            levels = dim_levels([seen], dimmers(6, brightest=2.0), margin)
            short[margin] += truth.lux(levels).min() < 60
            if margin:
                assert (seen.lux(levels) - 60 > 1.9 * seen.error(levels)).all()
    assert short[0.0] >= 8
    assert short[2.0] <= 2


@pytest.mark.parametrize(
    ("needed", "message"),
    [
        ({"target": 2000}, "desk gets at most .* of 2000 lx"),
        (
            {"target": 100, "uniformity": 0.99},
            "desk gets at most .* with the uniformity 0.99, or all of it with a smaller one",
        ),
    ],
)
def test_targets_out_of_reach_say_what_can_be_reached(needed, message):
    each = task(**needed)
    with pytest.raises(LumitreeError, match=message) as found:
        dim_levels([each], dimmers(), 0.0)
    # The numbers of the message are true: a little less can be reached.
    words = str(found.value).split()
    target = 0.99 * float(words[words.index("most") + 1])
    plane = TaskPlane((0, 0, 0), target=target, uniformity=needed.get("uniformity", 0))
    possible = dataclasses.replace(each, plane=plane)
    assert fulfils(possible, dim_levels([possible], dimmers(), 0.0), 1e-3)


def test_planes_that_exclude_each_other_are_named_together():
    bright, dark = task(0, target=200), task(0, maximum=150)
    with pytest.raises(LumitreeError, match=r"cannot be reached together, only .* for desk"):
        dim_levels([bright, dark], dimmers(), 0.0)


def test_steps_that_are_too_coarse_are_refused():
    each = task(target=100, maximum=330, uniformity=0.2, lamps=1)
    light = dataclasses.replace(each, lamps=np.full((30, 1), 400.0))
    with pytest.raises(LumitreeError, match="too coarse"):
        dim_levels([light], dimmers(1, steps=1), 0.0)


def test_a_step_is_the_best_within_its_limits():
    """Light that falls by 100 lx for a step along one axis, and is missing."""
    each = task(lamps=1, target=500)
    sloped = dataclasses.replace(
        each, lamps=np.column_stack([np.full(30, 300.0), np.full(30, 50.0)])
    )
    value, levels, steps = best_step([sloped], dimmers(1), np.array([-1.0]), np.array([2.0]))
    assert levels == pytest.approx([1])
    assert steps == pytest.approx([2])
    # 80 lx of 500 are missing.
    assert value == pytest.approx(1 + 10 * 80 / 500)


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({"uniformity": 1.5}, "uniformity is 1.5"),
        ({"target": 500, "maximum": 400}, "maximum is 400"),
        ({"target": -1}, "target is -1"),
    ],
)
def test_wrong_numbers_are_refused(values, message):
    with pytest.raises(LumitreeError, match=message):
        TaskPlane((0, 0, 0), **values)


def test_points_that_may_be_the_least_or_above_the_most_are_unsure():
    lux = np.array([100.0, 101, 103, 150, 197, 200])
    values = {"fixed": np.zeros(6), "lamps": lux[:, None], "variance": np.ones((6, 1))}
    each = dataclasses.replace(task(lamps=1), points=np.arange(10, 16), **values)
    assert each.unsure(np.ones(1)).tolist() == [10, 11, 12]
    each = dataclasses.replace(each, plane=dataclasses.replace(each.plane, maximum=500.0))
    assert each.unsure(np.ones(1)).tolist() == [10, 11, 12, 14, 15]


def test_rounding_takes_no_light_away():
    levels = np.array([1.4e-6, 0.123451, 1e-12, 0.99999])
    rounded = dimmers(4).rounded(levels)
    assert (rounded >= levels - 1e-11).all()
    assert rounded == pytest.approx([1.4e-6, 0.1235, 0, 1])
    steps = Dimmers(np.arange(2), np.ones(2), brightest=0.001, steps=1000)
    assert steps.rounded(np.array([0.000482, 0.0])).tolist() == [0.000482, 0.0]


@pytest.mark.parametrize(
    ("needed", "message"),
    [
        (
            {"target": 10.0, "maximum": 15.0},
            "has 20 lx by light of no lamp, above its maximum of 15",
        ),
        ({"target": 50.0, "uniformity": 1.0}, "gets at most [0-9]+ of 50 lx with the uniformity 1"),
    ],
)
def test_what_is_out_of_reach_is_told_in_numbers(needed, message):
    with pytest.raises(LumitreeError, match=message):
        dim_levels([task(**needed)], dimmers(), 2.0)
