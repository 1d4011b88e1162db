"""Long runs and ladders that go on where they stopped; errors without noise on known answers."""

import numpy as np
import pytest

from benchmarks.equal_error.batches import MAX_BATCHES, LongRun, code_digest, ladder
from benchmarks.equal_error.errors import (
    display_rmse,
    display_rows,
    squared_difference,
    time_to_reach,
)


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
    assert run.spp == 4 * MAX_BATCHES
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
    assert LongRun(tmp_path / "long.npz", "a").spp == again.spp == 48


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


SHAPE = (6, 8, 3)


def batches(random, count, mean=0.0, sigma=1.0):
    return mean + sigma * random.normal(size=(count, *SHAPE))


@pytest.mark.parametrize("difference", [0.0, 0.1, 1.0])
def test_squared_difference_is_free_of_noise(difference):
    random = np.random.default_rng(2)
    found = [
        squared_difference(
            batches(random, 9, difference, sigma=2.0), batches(random, 16, 0.0, sigma=0.5), 2.0
        )
        for _ in range(200)
    ]
    values = np.array([each.value for each in found])
    assert values.mean() == pytest.approx(
        2 * difference**2, abs=4 * values.std() / np.sqrt(len(values))
    )
    stated = np.sqrt(np.mean([each.error**2 for each in found]))
    # Where there is no difference the jackknife states up to half too much.
    assert 0.75 < stated / values.std() < 1.7
    # The plain difference would be far off.
    assert 5 * values.std() / np.sqrt(len(values)) < 2 * (4 / 9 + 0.25 / 16)


def test_time_to_reach_interpolates_and_extrapolates_a_power_law():
    seconds = 2.0 ** np.arange(1, 8)
    errors = 5 / np.sqrt(seconds)
    for level in (0.9, 1.7, errors[3]):
        time, kind = time_to_reach(level, seconds, errors)
        assert time == pytest.approx(25 / level**2)
        assert kind == "measured"
    time, kind = time_to_reach(0.01, seconds, errors)
    assert (time, kind) == (pytest.approx(25 / 0.01**2), "extrapolated")
    assert time_to_reach(100.0, seconds, errors) == (seconds[0], "measured")


def test_display_rmse_is_that_of_what_a_screen_shows():
    """Clipped pixels do not differ, and radiance has no unit."""
    reference = np.full((4, 4, 3), 0.5)
    reference[0, 0] = 100.0
    image = np.array([reference, 2 * reference])
    image[0, 0, 0] = 5.0
    found = display_rmse(image, reference)
    assert found[0] == 0
    # 0.18 and 0.36 are 118.0 and 162.2 in sRGB; the bright pixel is white in both.
    assert found[1] == pytest.approx(np.sqrt(15 / 16) * 44.2, rel=0.01)
    assert display_rmse(7 * image, 7 * reference) == pytest.approx(found, rel=1e-6)


@pytest.mark.parametrize("reference", ["explicit", "baked"])
def test_display_rows_subtract_the_noise_of_the_reference(reference):
    """Two methods without bias, of known noise: times in proportion to their variances."""
    random = np.random.default_rng(3)
    clean = np.full((40, 40, 3), 0.5)

    def noisy(count, deviation):
        return clean + random.normal(0, deviation, (count, 40, 40, 3))

    def rungs(deviation):
        return [
            {"samples": n, "images": noisy(1, deviation / n**0.5), "seconds": {"cpu": [float(n)]}}
            for n in (1, 4, 16, 64)
        ]

    runs = {
        "explicit": (rungs(0.4), noisy(16, 0.4 / 16), 16 * 256.0),
        "baked": (rungs(0.1), noisy(16, 0.1 / 16), 16 * 256.0),
    }
    rows, own = display_rows(runs, "cpu", reference=reference)
    assert own == pytest.approx(rows[reference][-1]["rmse"] / 2**0.5, rel=1e-6)
    for level in (8.0, 5.0):
        times = {}
        for name, points in rows.items():
            seconds, errors = (np.array([p[key] for p in points]) for key in ("seconds", "rmse"))
            times[name], _ = time_to_reach(level, seconds, errors)
        assert times["explicit"] / times["baked"] == pytest.approx(16, rel=0.25)


def test_kept_images_depend_on_all_code_that_renders(monkeypatch):
    from benchmarks.equal_error import batches

    files = []
    monkeypatch.setattr(batches, "digest", lambda *paths: files.extend(paths))
    code_digest()
    folders = {path.parent.name for path in files}
    assert {"rendering", "octree", "asset", "core"} <= folders
