"""Long runs and ladders that are interrupted and go on."""

import numpy as np
import pytest

from benchmarks.equal_error.batches import MAX_BATCHES, LongRun, digest, ladder


class Renderer:
    """Pictures whose pixels are normal numbers of variance 1 / samples, by seed."""

    def __init__(self):
        self.calls = []

    def __call__(self, samples, seed):
        self.calls.append((samples, seed))
        noise = np.random.default_rng(seed).normal(size=(4, 5, 3))
        return (1 + noise / np.sqrt(samples)).astype(np.float32)


def test_a_long_run_merges_its_batches_and_keeps_their_mean(tmp_path):
    render = Renderer()
    run = LongRun(tmp_path / "long.npz", "a")
    for _ in range(MAX_BATCHES):
        run.add(render)
    pictures = [Renderer()(samples, seed) for samples, seed in render.calls]
    assert run.mean == pytest.approx(np.mean(pictures, 0), abs=1e-5)
    assert len(run.batches) == MAX_BATCHES // 2
    assert run.samples_per_pixel == 4 * MAX_BATCHES
    # Each batch has twice the samples now: half the variance.
    assert run.batches.var(0, ddof=1).mean() == pytest.approx(1 / 8, rel=0.3)


def test_a_long_run_goes_on_with_new_seeds(tmp_path):
    first, second = Renderer(), Renderer()
    LongRun(tmp_path / "long.npz", "a").extend(first, 0.0)
    again = LongRun(tmp_path / "long.npz", "a")
    assert len(again.batches) == 8
    for _ in range(4):
        again.add(second)
    again.save()
    assert not {seed for _, seed in first.calls} & {seed for _, seed in second.calls}
    assert LongRun(tmp_path / "long.npz", "a").samples_per_pixel == again.samples_per_pixel == 48


def test_runs_have_no_common_seeds(tmp_path):
    seeds = [LongRun(tmp_path / "long.npz", name).next_seeds for name in ("a", "b")]
    assert not set(seeds[0]) & set(seeds[1])
    assert min(min(seeds[0]), min(seeds[1])) >= 1 << 14
    assert max(max(seeds[0]), max(seeds[1])) < 1 << 31


def test_a_ladder_keeps_its_rungs(tmp_path):
    first, second = Renderer(), Renderer()
    rungs = ladder(tmp_path, first, 60.0, max_rungs=5)
    assert [rung["samples"] for rung in rungs] == [1, 2, 4, 8, 16]
    assert all(len(rung["images"]) == len(rung["seconds"]["wall"]) for rung in rungs)
    longer = ladder(tmp_path, second, 60.0, max_rungs=6)
    assert {samples for samples, _ in second.calls} <= {1, 2, 32}  # warming up and the new one
    assert np.array_equal(longer[3]["images"], rungs[3]["images"])
    seeds = [seed for samples, seed in first.calls if samples > 2]
    assert len(set(seeds)) == len(seeds)


def test_a_ladder_stops_when_its_time_is_spent(tmp_path):
    assert [rung["samples"] for rung in ladder(tmp_path, Renderer(), 0.0)][-1] == 32


def test_digest_tells_values_and_files_apart(tmp_path):
    (tmp_path / "a").write_text("1")
    (tmp_path / "b").write_text("2")
    same = digest({"x": 1}, tmp_path / "a")
    assert same == digest({"x": 1}, tmp_path / "a")
    assert same != digest({"x": 1}, tmp_path / "b")
    assert same != digest({"x": 2}, tmp_path / "a")
