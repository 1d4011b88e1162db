"""Tables and pictures of times at equal error."""

from pathlib import Path

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter, LogLocator, NullFormatter

from benchmarks.common.tables import Table
from benchmarks.equal_error.readings import DISPLAY_LEVELS
from lumitree.core.files import atomic_path
from lumitree.core.images import tonemap

_HEADS = (
    "luminaire",
    "room",
    "baked: spp",
    "RMSE",
    "time",
    "explicit: spp",
    "time",
    "speedup",
    "s a sample: explicit",
    "baked",
    "lit",
    "lit, robust",
    "measured",
    "robust",
    "bake's RMSE",
    "reference's RMSE",
    "mean, baked / explicit",
    "where lit",
)
_COLOURS = {"explicit": "#b04a2f", "baked": "#2f6fb0"}


def table(rows: list[dict]) -> Table:
    """One row a pair, at the paper's number of samples."""
    lines = []
    for row in rows:
        at, bake = row["at_paper_samples"], row["bake"]
        cells = [
            row["luminaire"],
            row["room"],
            str(at["baked_spp"]),
            f"{at['rmse']:.3g}",
            _seconds(at["baked_seconds"]),
            _number(at["explicit_spp"]),
            _seconds(at["explicit_seconds"]),
            _times(at["speedup"], at["speedup_error"]),
            f"{row['seconds_per_sample']['explicit']:.3f}",
            f"{row['seconds_per_sample']['baked']:.3f}",
            _part(row, "lit"),
            _part(row, "lit_robust"),
            _reading(at, "measured"),
            _reading(at, "robust"),
            f"{bake['rmse']:.2g} (MSE {bake['mse']:.2g} ± {bake['mse_error']:.1g})",
            f"{row['reference']['rmse']:.2g}",
            f"{bake['mean_ratio']:.3f} ± {bake['mean_ratio_error']:.2g}",
            f"{row['lit']['mean_ratio']:.3f} ± {row['lit']['mean_ratio_error']:.2g}",
        ]
        lines.append(cells)
    return Table(_HEADS, lines, left=2)


def level_table(rows: list[dict], part: str | None = None) -> Table:
    """The expected RMSE of the baked lamp's rungs, and the speed-up at each.

    Args:
        part: which part of the picture, a key of `rows`; None for all of it.
    """
    rows = [row for row in rows if part is None or part in row]
    by_pair = [(row if part is None else row[part])["levels"] for row in rows]
    counts = sorted({level["baked_spp"] for levels in by_pair for level in levels})
    lines = []
    for row, levels in zip(rows, by_pair, strict=True):
        known = {level["baked_spp"]: level for level in levels}
        cells = [_level(known.get(count)) for count in counts]
        lines.append([row["luminaire"], row["room"], *cells])
    return Table(["luminaire", "room", *(f"{count} spp" for count in counts)], lines, left=2)


def display_table(rows: list[dict]) -> Table:
    """Times at the levels of `rmse_display`, and the speed-up."""
    rows = [row for row in rows if "display" in row]
    lines = [
        [
            row["luminaire"],
            row["room"],
            *(_display(level) for level in row["display"]["levels"]),
            f"{row['display']['reference']:.2g}",
            row["display"].get("reference_method", "explicit"),
        ]
        for row in rows
    ]
    heads = ["luminaire", "room", *(f"at {level:g}" for level in DISPLAY_LEVELS)]
    heads += ["reference's error", "reference"]
    return Table(heads, lines, left=2)


def _display(level: dict) -> str:
    if level["speedup"] is None:
        return "below the reference's error"
    beyond = "~" if level["explicit_kind"] == "extrapolated" else ""
    short = ">" if level["baked_kind"] == "extrapolated" else ""
    seconds = f"{_seconds(level['explicit'])} / {short}{_seconds(level['baked'])}"
    return f"{beyond}{_times(level['speedup'])} ({seconds})"


def _level(level: dict | None) -> str:
    if level is None:
        return ""
    return f"{_times(level['speedup'])} (RMSE {level['rmse']:.2g})"


def _part(row: dict, part: str) -> str:
    found = row[part]
    if found["speedup"] is None:
        return f"> {found['speedup_bound']:.3g}"
    return f"{_times(found['speedup'], found['speedup_error'])} ({found['baked_spp']} spp)"


def _reading(at: dict, name: str) -> str:
    mark = "~" if at[f"{name}_kind"] == "extrapolated" else ""
    return mark + _times(at[f"speedup_{name}"])


def _times(value: float | None, error: float | None = None) -> str:
    if value is None:
        return "below the reference's error"
    return f"{value:.3g}" + (f" ± {error:.2g}" if error is not None else "")


def _seconds(value: float | None) -> str:
    if value is None:
        return "-"
    return f"{value:.2g} s" if value < 100 else f"{value / 60:.3g} min"


def _number(value: float | None) -> str:
    return "-" if value is None else f"{value:,.0f}"


def draw_pictures(
    path: Path, row: dict, reference: np.ndarray, explicit: list[dict], baked: list[dict]
) -> None:
    """Reference, baked, and the explicit lamp in about the same time; below, their middles."""
    at = row["at_paper_samples"]
    ours = next(rung for rung in baked if rung["samples"] == at["baked_spp"])
    rungs = row["ladders"]["explicit"]
    gaps = [abs(np.log(rung["seconds"] / at["baked_seconds"])) for rung in rungs]
    theirs = int(np.argmin(gaps))
    our_row = next(r for r in row["ladders"]["baked"] if r["spp"] == at["baked_spp"])
    columns: list[tuple[str, np.ndarray, dict | None]] = [
        (f"reference: explicit, {row['reference']['spp']} spp", reference, None),
        ("baked", ours["images"][0], our_row),
        ("explicit, equal time", explicit[theirs]["images"][0], rungs[theirs]),
    ]
    if theirs != len(rungs) - 1:
        columns.append(("explicit, longest of the ladder", explicit[-1]["images"][0], rungs[-1]))
    # The room in the middle of the scale; the lamp itself may burn out.
    brightness = ours["images"][0].mean(-1)
    exposure = 0.18 / float(np.median(brightness[brightness > 0]))
    height, width = reference.shape[:2]
    middle = np.s_[height // 4 : height // 4 + height // 2, width // 4 : width // 4 + width // 2]
    figure = Figure(figsize=(4 * len(columns), 8 * height / width + 0.9), layout="constrained")
    axes = figure.subplots(2, len(columns))
    for (title, image, rung), (whole, crop) in zip(columns, axes.T, strict=True):
        if rung is not None:
            title += f"\n{rung['spp']} spp, {rung['seconds']:.2f} s, RMSE {rung['rmse']:.3g}"
        whole.set_title(title, fontsize=10)
        whole.imshow(tonemap(image, exposure))
        crop.imshow(tonemap(image[middle], exposure), interpolation="nearest")
        for each in (whole, crop):
            each.set_axis_off()
    _save(figure, path)


def draw_curves(path: Path, row: dict) -> None:
    """RMSE and trimmed relMSE against time, with what bounds them."""
    figure = Figure(figsize=(10, 4.2), layout="constrained")
    axes = figure.subplots(1, 2)
    for name, rungs in row["ladders"].items():
        seconds = np.array([rung["seconds"] for rung in rungs])
        for axis, key in zip(axes, ("rmse", "trimmed_rel_mse"), strict=True):
            values = np.array([rung[key] for rung in rungs])
            axis.plot(seconds, values, "o-", ms=3, color=_COLOURS[name], label=name)
        errors = np.array([rung["mse_error"] or 0.0 for rung in rungs])
        rmse = np.array([max(rung["rmse"], 1e-12) for rung in rungs])
        axes[0].errorbar(seconds, rmse, errors / (2 * rmse), fmt="none", ecolor=_COLOURS[name])
    bounds = row["reference"]
    axes[0].axhline(bounds["rmse"], ls=":", color="grey", label="reference's own error")
    axes[0].axhline(row["bake"]["rmse"], ls="--", color=_COLOURS["baked"], label="bake's error")
    axes[1].axhline(bounds["trimmed_rel_mse"], ls=":", color="grey", label="reference's own error")
    axes[0].set_ylabel("RMSE")
    axes[1].set_ylabel("relMSE without the worst 0.1 % of the pixels")
    for axis in axes:
        axis.set_xscale("log")
        axis.set_yscale("log")
        axis.xaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
        axis.xaxis.set_major_formatter(FormatStrFormatter("%g"))
        axis.xaxis.set_minor_formatter(NullFormatter())
        axis.set_xlabel(f"seconds ({row['clock']})")
        axis.grid(alpha=0.3, which="both")
        axis.legend(fontsize=8)
    figure.suptitle(f"{row['luminaire']} in {row['room']}")
    _save(figure, path)


def _save(figure: Figure, path: Path) -> None:
    FigureCanvasAgg(figure)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=80, format="png")
