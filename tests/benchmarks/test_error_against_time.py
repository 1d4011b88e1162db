"""Noise, differences without noise, trimmed errors and times at equal error, on known answers."""

import numpy as np
import pytest

from benchmarks.equal_error.error_against_time import (
    Estimate,
    Pace,
    display_rmse,
    noise,
    ratio_of_means,
    relative_weights,
    squared_difference,
    time_to_reach,
    trimmed_mean,
    trimming,
)
from benchmarks.equal_error.readings import Reference, headline, levels, rung_rows

SHAPE = (6, 8, 3)


def batches(random, count, mean=0.0, sigma=1.0):
    return mean + sigma * random.normal(size=(count, *SHAPE))


def test_trimmed_mean_leaves_out_the_worst_pixels():
    squares = np.ones((20, 50, 3))
    squares[3, 4] = [1e6, 0, 0]
    assert trimmed_mean(squares, 0.001) == 1.0
    assert trimmed_mean(squares, 0.0) == pytest.approx((999 + 1e6 / 3) / 1000)
    squares[7, 7] = 500.0
    assert trimmed_mean(squares, 0.001) == pytest.approx((998 + 500) / 999)


def test_relative_weights_do_not_depend_on_the_unit_or_on_single_pixels():
    picture = np.random.default_rng(0).uniform(0.5, 1.5, (30, 40, 3))
    weights = relative_weights(picture)
    assert relative_weights(7 * picture) * 49 == pytest.approx(weights)
    dark = picture.copy()
    dark[10, 10] = 0.0
    assert relative_weights(dark)[10, 10] == pytest.approx(weights[10, 10], rel=0.1)


def test_noise_is_unbiased_and_knows_its_error():
    random = np.random.default_rng(1)
    found = [noise(batches(random, 8, mean=3.0)) for _ in range(300)]
    values = np.array([each.value for each in found])
    assert values.mean() == pytest.approx(1 / 8, abs=4 * values.std() / np.sqrt(300))
    stated = np.sqrt(np.mean([each.error**2 for each in found]))
    assert stated == pytest.approx(values.std(), rel=0.3)


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


def test_ratio_of_means():
    random = np.random.default_rng(3)
    ratios = [ratio_of_means(batches(random, 10, 6.0), batches(random, 10, 3.0)) for _ in range(99)]
    values = np.array([each.value for each in ratios])
    assert values.mean() == pytest.approx(2.0, abs=4 * values.std() / 10)
    assert np.mean([each.error for each in ratios]) == pytest.approx(values.std(), rel=0.3)


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


def test_a_lucky_picture_does_not_count_as_reached():
    """A firefly at 4 seconds: only after it the errors stay below."""
    time, kind = time_to_reach(0.5, np.array([1.0, 2.0, 4.0, 8.0]), np.array([0.8, 0.4, 0.9, 0.3]))
    assert 4 < time < 8
    assert kind == "measured"


def pictures(random, samples, sigma, truth):
    images = truth + sigma / np.sqrt(samples) * random.normal(size=(3, *truth.shape))
    times = np.full(3, float(samples))
    return {"samples": samples, "images": images, "seconds": {"wall": times, "cpu": times}}


def test_readings_find_the_known_speedup():
    """Sixteen times the variance at the same speed, and a bias that sets in."""
    random = np.random.default_rng(4)
    truth = random.uniform(0.5, 1.5, (40, 50, 3))
    bias = 0.05
    explicit = [pictures(random, 1 << i, 4.0, truth) for i in range(12)]
    baked = [pictures(random, 1 << i, 1.0, truth + bias) for i in range(8)]
    long = truth + 4.0 / np.sqrt(4096) * random.normal(size=(16, *truth.shape))
    reference = Reference.of(long)
    rows = rung_rows(explicit, reference, "wall"), rung_rows(baked, reference, "wall")
    assert rows[0][5]["rmse"] == pytest.approx(4 / np.sqrt(32), rel=0.03)
    assert rows[1][7]["rmse"] == pytest.approx(np.hypot(bias, 1 / np.sqrt(128)), rel=0.03)
    paces = Pace(Estimate(16, 0.5), 1.0), Pace(Estimate(1, 0.1), 1.0, bias**2)
    readings = levels(*rows, paces, reference)
    for row in readings:
        expected = 16 / (bias**2 + 1 / row["baked_spp"]) / row["baked_spp"]
        assert row["speedup"] == pytest.approx(expected)
        assert row["speedup_error"] == pytest.approx(expected / 32)
        assert row["speedup_measured"] == pytest.approx(expected, rel=0.15)
        assert row["speedup_robust"] == pytest.approx(expected, rel=0.15)
    assert headline(readings)["baked_spp"] == 32


def test_nothing_is_compared_below_the_references_own_error():
    random = np.random.default_rng(5)
    truth = np.ones((20, 20, 3))
    reference = Reference.of(truth + random.normal(size=(8, *truth.shape)))
    explicit = [pictures(random, 1 << i, 1.0, truth) for i in range(3)]
    baked = [pictures(random, 1 << i, 0.1, truth) for i in range(3)]
    rows = rung_rows(explicit, reference, "wall"), rung_rows(baked, reference, "wall")
    paces = Pace(Estimate(1, 0), 1.0), Pace(Estimate(0.01, 0), 1.0)
    (first, *_) = levels(*rows, paces, reference)
    assert first["speedup"] is None
    assert first["explicit_seconds"] is None
    assert first["speedup_measured"] is None


def test_the_readable_row_lies_above_the_references_own_error():
    from benchmarks.equal_error.readings import readable

    rows = [{"baked_spp": 1 << i, "speedup": 7.0 if i < 3 else None} for i in range(7)]
    assert readable(rows)["baked_spp"] == 4
    assert readable([row | {"speedup": 1.0} for row in rows])["baked_spp"] == 32
    assert readable([row | {"speedup": None} for row in rows])["speedup"] is None


def test_trimming_leaves_out_the_worst_of_each_picture():
    first, second = np.ones((2, 20, 50, 3))
    first[3, 4], second[5, 6] = 9.0, 7.0
    kept = trimming(first, second)
    assert kept.shape == (20, 50, 1)
    assert kept.sum() == 998
    assert not kept[3, 4]
    assert not kept[5, 6]


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
