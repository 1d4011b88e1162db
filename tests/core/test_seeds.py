"""One stream of seeds: distinct, repeatable, checked."""

import itertools

import numpy as np
import pytest

from lumitree.core.seeds import MAX_SEED, Purpose, SeedStream, check_seed
from lumitree.errors import LumitreeError


def test_purposes_steps_draws_and_parts_have_seeds_of_their_own():
    seeds = [
        SeedStream(purpose, step, draw).seed(root, part)
        for purpose, step, draw, root, part in itertools.product(
            Purpose, (0, 1, 2, 2**32 - 1), range(4), (0, 1, MAX_SEED), range(3)
        )
    ]
    assert all(0 <= seed < 2**32 for seed in seeds)
    assert len(set(seeds)) == len(seeds)


def test_a_seed_is_always_the_same():
    """Fixed values: what a seed gives must not change from version to version unnoticed."""
    found = [SeedStream(Purpose.CAPTURE, 1).seed(0), SeedStream(Purpose.RENDER, 2, 3).seed(5, 4)]
    assert found == [2150671595, 1432857803]


def test_no_two_purposes_have_one_number():
    """The second would be an alias of the first, and share its random numbers."""
    assert list(Purpose.__members__) == [purpose.name for purpose in Purpose]


def test_neighbouring_seeds_of_a_sampler_are_independent(mi):
    """Mitsuba hashes the seed with the index of the lane: seed s + 1 is not seed s shifted."""
    count = 1 << 12
    sampler = mi.load_dict({"type": "independent"})

    def draw(seed):
        sampler.seed(seed, count)
        return np.concatenate([np.array(sampler.next_1d()) for _ in range(4)])

    first = draw(1)
    assert np.array_equal(first, draw(1))
    for seed in (0, 2, 3):
        other = draw(seed)
        assert len(np.intersect1d(first, other)) < 40
        assert abs(np.corrcoef(first, other)[0, 1]) < 5 / np.sqrt(len(first))


@pytest.mark.parametrize("seed", [-1, MAX_SEED + 1, 10**400, 1.0, "1", None, True, float("nan")])
def test_what_is_no_seed_is_refused(seed):
    with pytest.raises(LumitreeError, match="expected a whole number from 0 to 2147483647") as e:
        check_seed(seed)
    assert "\n" not in str(e.value)
    with pytest.raises(LumitreeError):
        SeedStream(Purpose.RENDER).seed(seed)


def test_the_ends_of_the_range_are_seeds():
    assert check_seed(0) == 0
    assert check_seed(MAX_SEED) == MAX_SEED
