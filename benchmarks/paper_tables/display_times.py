"""Times at equal `rmse_display` of several methods, from their ladders and long runs."""

from typing import TYPE_CHECKING, Any

import numpy as np

from benchmarks.equal_error.error_against_time import time_to_reach
from benchmarks.equal_error.readings import display_rows, noise_of_mean

if TYPE_CHECKING:
    from benchmarks.equal_error.method import Method


def pace(method: "Method") -> float:
    """CPU seconds of a sample a pixel, from the long run."""
    return method.long.seconds["cpu"] / method.long.samples_per_pixel


def _paced(method: "Method") -> list[dict[str, Any]]:
    """Rungs whose time is that of their samples in the long run.

    The fixed cost of a small image, about a second, is more than that of its first samples. It does
    not grow with the size of an image.
    """
    own = pace(method)
    return [
        {**rung, "seconds": {"cpu": np.array([rung["samples"] * own])}} for rung in method.rungs
    ]


def readings(
    methods: "dict[str, Method]", levels: tuple[float, ...], weights: Any, reference: str
) -> dict[str, Any]:
    """For each method its bias, and its CPU seconds and samples at each level.

    A level below `floor`, or below the bias of a method, has none.

    Args:
        levels: of `rmse_display`.
        weights: [H, W, 1] of squared errors, of mean 1.
        reference: name of the method whose long run is the reference.

    Returns:
        `levels`; `reference`, its own error; `floor`, twice that: below it, an error is not known
        well enough, since the encoding of a noisy reference is darker than that of its mean; and
        `methods`, by name. With another reference than the explicit lamp, the explicit lamp's time
        is that of its long run where that has not reached a level, and `at_least` is true.
    """
    runs = {
        name: (_paced(method), method.long.batches, method.long.seconds["cpu"])
        for name, method in methods.items()
    }
    rows, own = display_rows(runs, "cpu", weights, reference)
    floor = 2 * own
    found: dict[str, Any] = {"reference": own, "floor": floor, "levels": list(levels)}
    found["methods"] = {}
    for name, method in methods.items():
        noise = noise_of_mean(method.long.batches, weights)
        last, spent = rows[name][-1]["rmse"], method.long.seconds["cpu"]
        unbiased = name in ("explicit", reference)
        bias = 0.0 if unbiased else float(np.sqrt(max(last**2 - noise**2, 0.0)))
        beyond = [name == "explicit" != reference and level < last for level in levels]
        times = [
            spent if short else seconds_at(level, rows[name], bias, floor, spent, noise)
            for level, short in zip(levels, beyond, strict=True)
        ]
        own_pace = pace(method)
        found["methods"][name] = {
            "bias": bias,
            "seconds": times,
            "samples": [None if time is None else time / own_pace for time in times],
            "at_least": beyond,
            "points": rows[name],
        }
    return found


def seconds_at(
    level: float,
    points: list[dict[str, float]],
    bias: float,
    floor: float,
    long_seconds: float,
    noise: float,
) -> float | None:
    """CPU seconds for an error of `level`; None where it is below `floor` or `bias`.

    Between measured points by interpolation. Beyond the last one the squared error is the squared
    bias, plus a noise that falls as 1 / time.
    """
    if level <= max(bias, floor):
        return None
    ordered = sorted(points, key=lambda point: point["seconds"])
    seconds = np.array([point["seconds"] for point in ordered])
    errors = np.array([max(point["rmse"], 1e-9) for point in ordered])
    found, kind = time_to_reach(level, seconds, errors)
    if kind == "measured":
        return found
    return long_seconds * noise**2 / (level**2 - bias**2)


def speedup_of(methods: dict[str, Any], name: str, level: int) -> float | None:
    """Seconds of the explicit lamp over those of a method; None where either has none."""
    explicit, own = methods["explicit"]["seconds"][level], methods[name]["seconds"][level]
    return None if explicit is None or own is None else explicit / own
