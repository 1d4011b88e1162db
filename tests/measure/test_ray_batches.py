"""Batches of rays and their pieces, and the jackknife."""

import numpy as np
import pytest

from lumitree.core.seeds import Purpose, SeedStream
from lumitree.measure.batches import BATCHES, RayBatches, jackknife, jackknife_error


class Recorded:
    """Rays that are only counted."""

    def __init__(self):
        self.draws = []

    def draw(self, count, seed):
        self.draws.append((count, seed))
        return len(self.draws)


@pytest.mark.parametrize(("num_rays", "pieces", "size"), [(1, 1, 1), (160, 1, 10), (161, 2, 6)])
def test_batches_are_drawn_in_equal_pieces_with_seeds_of_their_own(num_rays, pieces, size):
    rays = Recorded()
    batches = RayBatches(
        rays,
        num_rays,
        lambda batch, piece: SeedStream(Purpose.PHOTOMETRY, batch, piece),
        seed=3,
        pieces=pieces,
    )
    assert (batches.count, batches.size) == (pieces * BATCHES, size)
    found = list(batches)
    assert found == [(index % BATCHES, index + 1) for index in range(batches.count)]
    seeds = [batches.seed(index) for index in range(batches.count)]
    assert rays.draws == [(size, seed) for seed in seeds]
    assert len(set(seeds)) == batches.count
    last = SeedStream(Purpose.PHOTOMETRY, BATCHES - 1, pieces - 1)
    assert seeds[-1] == last.seed(3)


def test_jackknife_of_a_mean():
    values = np.random.default_rng(0).random((BATCHES, 3))
    mean, error = jackknife(lambda used: values[used].mean(axis=0))
    assert mean == pytest.approx(values.mean(axis=0))
    assert error == pytest.approx(values.std(axis=0, ddof=1) / np.sqrt(BATCHES))


def test_jackknife_error_of_figures_without_each_batch():
    values = np.random.default_rng(0).random((5, 2))
    without = (values.sum(axis=0) - values) / 4
    expected = values.std(axis=0, ddof=1) / np.sqrt(5)
    assert jackknife_error(without) == pytest.approx(expected)
