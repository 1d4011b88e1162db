"""What a ladder of pictures and two efficiencies say about the time at equal error."""

import dataclasses

import numpy as np

from benchmarks.equal_error.error_against_time import (
    Estimate,
    Floats,
    Pace,
    display_rmse,
    noise,
    relative_weights,
    time_to_reach,
    trimmed_mean,
)

PAPER_SAMPLES = 32
# `rmse_display` that the paper's equal-quality comparison ends at (its Table 5).
DISPLAY_LEVELS = (8.0, 5.0, 2.7)


@dataclasses.dataclass(frozen=True)
class Reference:
    """A converged picture and what is known of its own error.

    Attributes:
        picture: [H, W, 3] the mean of its batches.
        weights: [H, W, 3] of the relMSE.
        own, own_relative: mean squared error by its noise, plain and weighted.
        own_trimmed: the same, weighted, without the worst pixels.
    """

    picture: Floats
    weights: Floats
    own: Estimate
    own_relative: Estimate
    own_trimmed: float

    @staticmethod
    def of(batches: Floats) -> "Reference":
        """Reference of independent batches [K, H, W, 3]."""
        picture = batches.mean(0, dtype=np.float64)
        weights = relative_weights(picture)
        variance = batches.var(0, ddof=1, dtype=np.float64) / len(batches)
        return Reference(
            picture,
            weights,
            noise(batches),
            noise(batches, weights),
            trimmed_mean(variance * weights),
        )

    def summary(self) -> dict:
        """For the report."""
        rmse = float(np.sqrt(self.own.value))
        return {
            "mean": float(self.picture.mean()),
            "rmse": rmse,
            "rmse_error": self.own.error / (2 * rmse) if rmse else 0.0,
            "rel_mse": self.own_relative.value,
            "trimmed_rel_mse": self.own_trimmed,
        }


def rung_rows(rungs: list[dict], reference: Reference, clock: str) -> list[dict]:
    """Errors of the rungs, means over their pictures.

    RMSE and relMSE are without what the reference's own noise adds (on average; so they may be
    0 near it); the trimmed relMSE is with it.
    """
    rows = []
    for rung in rungs:
        squares = (rung["images"] - reference.picture) ** 2
        mse = squares.mean(axis=(1, 2, 3)) - reference.own.value
        relative = (squares * reference.weights).mean(axis=(1, 2, 3))
        count = len(mse)
        rows.append(
            {
                "spp": rung["samples"],
                "seconds": float(np.median(rung["seconds"][clock])),
                "pictures": count,
                "rmse": float(np.sqrt(max(mse.mean(), 0.0))),
                "mse": float(mse.mean()),
                "mse_error": float(mse.std(ddof=1) / np.sqrt(count)) if count > 1 else None,
                "rel_mse": float(relative.mean()) - reference.own_relative.value,
                "trimmed_rel_mse": float(
                    np.mean([trimmed_mean(each * reference.weights) for each in squares])
                ),
            }
        )
    return rows


def levels(
    explicit: list[dict], baked: list[dict], paces: tuple[Pace, Pace], reference: Reference
) -> list[dict]:
    """One row for each of the baked lamp's rungs: the time either method needs for its error.

    The level of `speedup` is the expected RMSE of the rung, with the bake's error in it. It is None
    where that lies below the reference's own error, and so are the other readings.
    """
    rows = expected_levels([rung["spp"] for rung in baked], *paces, reference.own.value)
    for row, rung in zip(rows, baked, strict=True):
        row |= _measured(rung, explicit, "rmse", reference.own.value**0.5, "measured")
        row |= _measured(rung, explicit, "trimmed_rel_mse", reference.own_trimmed, "robust")
    return rows


def display_rows(
    runs: dict[str, tuple[list[dict], Floats, float]],
    clock: str,
    weights: Floats | float = 1.0,
    reference: str = "explicit",
) -> tuple[dict[str, list[dict]], float]:
    """`rmse_display` of the ladders and of the long runs, and that of the reference.

    The reference is the long run of one of them. Its own error is half the difference between the
    means of its odd and its even batches, and is subtracted from all others. Its last
    image is the mean of every second batch: its error is that difference over √2.

    Args:
        runs: rungs, batches [K, H, W, 3] of the long run, and its seconds, by method.
        clock: that the seconds of rungs are by.
        weights: see `display_rmse`.
        reference: name of the method whose long run is the reference.
    """
    goal = runs[reference][1].mean(0)
    difference = noise_of_mean(runs[reference][1], weights) * 2
    own = difference / 2
    rows = {}
    for name, (rungs, batches, seconds) in runs.items():
        rows[name] = [
            {
                "seconds": float(np.median(rung["seconds"][clock])),
                "rmse": _without(display_rmse(rung["images"], goal, weights), own),
            }
            for rung in rungs
        ]
        last = {
            "seconds": seconds,
            "rmse": _without(display_rmse(batches.mean(0)[None], goal, weights), own),
        }
        if name == reference:
            last = {"seconds": seconds / 2, "rmse": difference / np.sqrt(2)}
        rows[name].append(last)
    return rows, own


def noise_of_mean(batches: Floats, weights: Floats | float = 1.0) -> float:
    """`rmse_display` of the mean of batches [K, H, W, 3] by their noise.

    Half of that of the mean of the even batches against the mean of the odd ones.
    """
    halves = batches[0::2].mean(0), batches[1::2].mean(0)
    return float(display_rmse(halves[0][None], halves[1], weights)[0]) / 2


def _without(errors: Floats, own: float) -> float:
    """Root of the mean of squared errors, without that of the reference."""
    return float(np.sqrt(max((errors**2).mean() - own**2, 0.0)))


def display_levels(rows: dict[str, list[dict]], own: float) -> list[dict]:
    """Seconds of both methods for each of `DISPLAY_LEVELS`, and the speed-up.

    None for levels below the reference's own error.
    """
    found = []
    for level in DISPLAY_LEVELS:
        row: dict = {"level": level, "speedup": None}
        if level > own:
            for name, points in rows.items():
                points = sorted(points, key=lambda point: point["seconds"])
                seconds = np.array([point["seconds"] for point in points])
                errors = np.array([max(point["rmse"], 1e-9) for point in points])
                row[name], row[f"{name}_kind"] = time_to_reach(level, seconds, errors)
            row["speedup"] = row["explicit"] / row["baked"]
        found.append(row)
    return found


def expected_levels(counts: list[int], explicit: Pace, baked: Pace, floor: float) -> list[dict]:
    """What `levels` says of expected errors, for numbers of samples a pixel of the baked lamp.

    Args:
        floor: mean squared error of the reference; nothing is compared below it.
    """
    rows = []
    for count in counts:
        square = baked.variance.value / count + max(baked.bias, 0.0)
        row = {
            "baked_spp": count,
            "baked_seconds": count * baked.seconds,
            "rmse": float(np.sqrt(square)),
            "explicit_seconds": None,
            "explicit_spp": None,
            "speedup": None,
            "speedup_error": None,
        }
        if square > floor:
            samples = explicit.variance * (1 / square)
            speedup = samples * (explicit.seconds / row["baked_seconds"])
            row["explicit_seconds"] = samples.value * explicit.seconds
            row["explicit_spp"] = samples.value
            row["speedup"], row["speedup_error"] = speedup.value, speedup.error
        rows.append(row)
    return rows


def _measured(rung: dict, explicit: list[dict], key: str, floor: float, name: str) -> dict:
    """Speed-up by the ladder's own errors, and whether the explicit time was reached."""
    speedup, kind = None, None
    if rung[key] > floor:
        # Squared errors fall as 1 / time beyond the ladder; `time_to_reach` takes roots.
        power = 1.0 if key == "rmse" else 0.5
        seconds = np.array([each["seconds"] for each in explicit])
        errors = np.array([max(each[key], 1e-30) ** power for each in explicit])
        reached, kind = time_to_reach(rung[key] ** power, seconds, errors)
        speedup = reached / rung["seconds"]
    return {f"speedup_{name}": speedup, f"{name}_kind": kind}


def readable(rows: list[dict]) -> dict:
    """Of the rows above the reference's error that of most samples, up to the paper's number."""
    known = [row for row in rows if row["speedup"] is not None]
    return headline(known or rows)


def headline(rows: list[dict]) -> dict:
    """The row of the number of samples nearest to the paper's."""
    return min(rows, key=lambda row: abs(np.log(row["baked_spp"] / PAPER_SAMPLES)))
