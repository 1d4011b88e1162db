"""Table 5: time at equal `rmse_display`, from the paper's way of using the field to ours.

Methods, each with all of what the one before it has:

* explicit: the lamp itself, path traced; the reference is its long run;
* proxy: as the paper: an octree of density and harmonics, directions sampled uniformly over the
  proxy, thresholds σ_min = 0.1 and α_max = 0.9;
* divided: illumination by the light field, appearance by the lamp's geometry (by the field
  for lamps with media).

All are compared with the reference at the RMSE that the paper's method has for this lamp, and at
coarser levels, over the whole image and over the pixels that do not show the lamp's box.
"""

import dataclasses
import io
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter

from benchmarks.equal_error.pairs import Pair, make_pair, shows_lamp
from benchmarks.paper_tables.cells import Cell, Found, Measured
from benchmarks.paper_tables.methods import Method, Way, pace, readings, speedup_of
from benchmarks.paper_tables.pictures import stack, strip
from benchmarks.paper_tables.scales import LAMPS, Scale
from benchmarks.paper_tables.scoring import costs
from benchmarks.paper_tables.work import Work
from lumitree.asset.file import load, save
from lumitree.core.files import write_bytes
from lumitree.core.images import tonemap
from lumitree.errors import LumitreeError

# Room, samples, RMSE and seconds of path tracing and of the paper's method, speed-up as printed.
PAPER = {
    "portica": ("Living Room", (4096, 7.1211, 84 * 60.0), (32, 6.8146, 52.4), 96.2),
    "dallas": ("Bedroom", (1024, 7.9824, 24.6 * 60), (32, 7.9228, 84.0), 17.57),
    "cluster": ("Living Room 2", (1024, 7.5267, 19 * 60.0), (4, 7.4239, 11.9), 95.8),
    "neoclassical": ("Bedroom", (1024, 7.2304, 14.1 * 60), (16, 7.3782, 22.2), 38.11),
    "star": ("Living Room 2", (512, 2.6439, 7.8 * 60), (32, 2.7113, 53.0), 8.83),
}
# Where the stand-ins hang.
ROOMS = {
    "portica": "living_room",
    "dallas": "veach_bidir",
    "cluster": "modern_hall",
    "neoclassical": "veach_bidir",
    "star": "modern_hall",
}
METHODS = {
    "proxy": "the paper: uniform over the proxy, thresholds",
    "divided": "light field, geometry as appearance",
}
COARSER = (12.0, 25.0)
# Methods whose long run is the reference, and what the page calls it.
REFERENCES = {
    "explicit": "the explicit lamp's long run",
    "divided": "the long run of the divided method",
}
PARTS = {"whole": "whole image", "beside": "beside the lamp"}
_LABELS = {
    "proxy": "the paper's way",
    "divided": "illumination and\nappearance divided",
}
_DPI = 110
# Where the paper's own figures are.
_PRINTED = -0.9
# Parts of the time: the reference and its ladder; each method's long run and ladder.
_REFERENCE, _REFERENCE_LADDER, _LONG, _LADDER = 0.55, 0.09, 0.08, 0.04


def cells(scale: Scale) -> list[Cell]:
    """One for each lamp."""
    return [
        Cell(
            f"5-{lamp}",
            5,
            {"lamp": lamp, "direct": scale.direct, "equal": scale.equal, "levels": _levels(lamp)},
            scale.equal.seconds / 60 * 1.1 + scale.minutes[1],
            lambda work, lamp=lamp: measure(work, lamp),
        )
        for lamp in scale.equal_lamps
    ]


def _levels(lamp: str) -> tuple[float, ...]:
    return PAPER[lamp][2][1], *COARSER


def measure(work: Work, lamp: str) -> Measured:
    """Long runs and ladders of all methods, and the time of each at each level."""
    if work.rooms is None:
        raise LumitreeError(f"5-{lamp} needs a room; give the folder of rooms with --rooms")
    asset = work.direct_asset(lamp, work.scale.direct)
    field_only = asset.path.with_name("field.lumitree")
    if not field_only.is_file():
        save(dataclasses.replace(load(asset.path), light_field=None, geometry=None), field_only)
    pair = make_pair(lamp, asset.path, work.rooms, ROOMS[lamp], "hanging")
    methods = _methods(pair, field_only, work)
    seconds = work.scale.equal.seconds
    for name, method in methods.items():
        parts = (_REFERENCE, _REFERENCE_LADDER) if name == "explicit" else (_LONG, _LADDER)
        method.spend(parts[0] * seconds, parts[1] * seconds)
    beside = 1.0 - shows_lamp(methods["proxy"].scene)
    weights = {"whole": np.ones_like(beside), "beside": beside / beside.mean()}
    parts = {
        reference: {
            name: readings(methods, _levels(lamp), each, reference)
            for name, each in weights.items()
        }
        for reference in REFERENCES
    }
    values: dict[str, Any] = {
        "room": ROOMS[lamp],
        "parts": parts,
        "seconds_per_sample": {name: pace(method) for name, method in methods.items()},
        "has_geometry": load(asset.path).geometry is not None,
        "costs": costs(asset),
    }
    images = {
        "time": sheet(methods, equal_time(methods)),
        "quality": sheet(methods, equal_quality(methods, parts["divided"]["whole"])),
    }
    return Measured(values, images)


def _methods(pair: Pair, field: Path, work: Work) -> dict[str, Method]:
    equal, cache = work.scale.equal, work.folder / "equal-quality"
    alone = dataclasses.replace(pair, asset=str(field))
    return {
        "explicit": Method(pair, False, equal, cache),
        "proxy": Method(alone, True, equal, cache, Way("uniform", 0.1, 0.9)),
        "divided": Method(pair, True, equal, cache),
    }


def equal_time(methods: dict[str, Method]) -> list[Any]:
    """Image [H, W, 3] of each method in about the time of 16 samples of the last one."""
    ours = methods["divided"].rungs
    seconds = float(np.median(ours[min(4, len(ours) - 1)]["seconds"]["cpu"]))
    images = []
    for method in methods.values():
        times = [np.median(rung["seconds"]["cpu"]) for rung in method.rungs]
        index = int(np.argmin(np.abs(np.log(np.array(times) / seconds))))
        images.append(method.rungs[index]["images"][0])
    return images


def equal_quality(methods: dict[str, Method], reading: dict[str, Any]) -> list[Any]:
    """Image [H, W, 3] of each method whose error is nearest to the paper's."""
    level, images = reading["levels"][0], []
    for name, method in methods.items():
        errors = [max(point["rmse"], 1e-9) for point in reading["methods"][name]["points"]]
        index = int(np.argmin(np.abs(np.log(np.array(errors) / level))))
        # The last point is the long run's.
        rungs = method.rungs
        images.append(rungs[index]["images"][0] if index < len(rungs) else method.long.mean)
    return images


def sheet(methods: dict[str, Method], images: list[Any]) -> Any:
    """The reference and an image of each method; the middle of each below."""
    reference = methods["explicit"].long.mean
    # The long run of least noise, with the same light.
    brightness = methods["divided"].long.mean.mean(-1)
    exposure = 0.18 / float(np.median(brightness[brightness > 0]))
    height, width = reference.shape[:2]
    crop = np.s_[height // 4 : height // 4 + height // 2, width // 4 : width // 4 + width // 2]
    factor = max(1, 320 // width)
    rows = []
    for part, scale in ((np.s_[:, :], factor), (crop, 2 * factor)):
        tiles = [
            tonemap(np.ascontiguousarray(image[part]), exposure) for image in (reference, *images)
        ]
        rows.append(strip([tile.repeat(scale, 0).repeat(scale, 1) for tile in tiles]))
    least = min(row.shape[1] for row in rows)
    return stack([row[:, :least] for row in rows])


def section(found: Found) -> str:
    """The paper's table beside ours, then all levels, and the images."""
    text = ""
    for reference, of in REFERENCES.items():
        for part, title in PARTS.items():
            text += f"At the paper's RMSE, {title}, against {of}:\n\n"
            text += f"{_paper_level(found, reference, part)}\n"
    if not found.has(*(f"5-{lamp}" for lamp in LAMPS)):
        return text
    text += f"At coarser levels:\n\n{_coarser(found)}\n"
    if draw_ladder(found):
        text += found.image("page", "ladder", "Speed-up over the explicit lamp, by method")
    text += "Reference, explicit, the paper's way, divided; below, the middle of each. First in "
    text += "about equal time, then at about the paper's RMSE. Images of commits up to 5a6685d "
    text += "also show importance sampling of the octree's leaves, before the last column.\n\n"
    return text + "".join(
        found.image(f"5-{lamp}", name, f"{lamp}, equal {name}")
        for lamp in LAMPS
        for name in ("time", "quality")
    )


def _paper_level(found: Found, reference: str, part: str) -> str:
    heads = ["lamp", "room (paper / ours)", "RMSE", "paper: PT spp, s", "ours spp, s", "speed-up"]
    heads += ["explicit: spp, CPU s"]
    for name in METHODS:
        heads += [f"{name}: spp, CPU s", "speed-up"]
    rows = []
    for lamp, (room, traced, theirs, speedup) in PAPER.items():
        values = found.values(f"5-{lamp}")
        row = [lamp, f"{room} / {values.get('room', '')}", f"{theirs[1]:.2f}"]
        row += [f"{traced[0]}, {traced[2]:.0f}", f"{theirs[0]}, {theirs[2]:.0f}", f"{speedup:.1f}"]
        if values:
            reading = values["parts"][reference][part]
            row.append(_cost(reading, "explicit", 0))
            for name in METHODS:
                row += [_cost(reading, name, 0), _times(reading, name, 0)]
        else:
            row += [found.missing] * (1 + 2 * len(METHODS))
        rows.append(row)
    return found.table(heads, rows, left=2)


def _coarser(found: Found) -> str:
    heads = ["lamp", "part", "reference", "its error", *(f"{name}: bias" for name in METHODS)]
    heads += [f"{name} at {level:g}" for level in COARSER for name in METHODS]
    rows = []
    for lamp in LAMPS:
        values = found.values(f"5-{lamp}")
        pairs = [(reference, part) for reference in REFERENCES for part in PARTS]
        for reference, part in pairs if values else ():
            reading = values["parts"][reference][part]
            methods = reading["methods"]
            row = [lamp, PARTS[part], reference, f"{reading['reference']:.1f}"]
            # A bias that is not larger than twice the reference's error is not known to be one.
            row += [
                f"{methods[name]['bias']:.1f}"
                if methods[name]["bias"] > reading["floor"]
                else f"below {reading['floor']:.1f}"
                for name in METHODS
            ]
            row += [
                _times(reading, name, index + 1)
                for index in range(len(COARSER))
                for name in METHODS
            ]
            rows.append(row)
    return found.table(heads, rows, left=3)


def _cost(reading: dict[str, Any], name: str, level: int) -> str:
    method = reading["methods"][name]
    if method["seconds"][level] is not None:
        sign = "> " if method["at_least"][level] else ""
        return f"{sign}{method['samples'][level]:.3g}, {method['seconds'][level]:.3g}"
    if reading["levels"][level] <= reading["floor"]:
        return f"reference: {reading['reference']:.1f}"
    return f"bias: {method['bias']:.1f}"


def _times(reading: dict[str, Any], name: str, level: int) -> str:
    methods = reading["methods"]
    value = speedup_of(methods, name, level)
    if value is None:
        return "none"
    return f"{'> ' if methods['explicit']['at_least'][level] else ''}{value:.3g}"


def draw_ladder(found: Found) -> bool:
    """Plot of the speed-up by method for each lamp; False where no cell has one.

    At the paper's level where all methods reach it, else at the lowest level that most reach.
    """
    lines = {}
    for lamp in LAMPS:
        values = found.values(f"5-{lamp}")
        for part in PARTS if values else ():
            reading = values["parts"]["divided"][part]
            methods, levels = reading["methods"], reading["levels"]
            speedups = [
                [speedup_of(methods, name, i) for name in METHODS] for i in range(len(levels))
            ]
            known = [sum(value is not None for value in row) for row in speedups]
            best = known.index(max(known))
            bound = methods["explicit"]["at_least"][best]
            lines[lamp, part] = Line(levels[best], speedups[best], bound)
    if not lines:
        return False
    paper = {lamp: row[3] for lamp, row in PAPER.items()}
    ladder(found.image_path("ladder"), lines, list(METHODS), PARTS, paper)
    return True


@dataclasses.dataclass(frozen=True)
class Line:
    """Speed-ups of one lamp.

    Attributes:
        level: of `rmse_display`.
        speedups: by method; None where a method does not reach the level.
        at_least: whether they are lower bounds.
    """

    level: float
    speedups: Sequence[float | None]
    at_least: bool


def ladder(
    path: Path,
    lines: Mapping[tuple[str, str], Line],
    methods: Sequence[str],
    parts: Mapping[str, str],
    paper: Mapping[str, float],
) -> None:
    """Speed-up over the explicit lamp by method, a line for each lamp, a panel for each part.

    Args:
        path: of the JPEG.
        lines: by lamp and part. Lower bounds are drawn as triangles.
        methods: names, from left to right.
        parts: titles of the panels by name.
        paper: the paper's speed-up of each lamp, of the first method, for the first part.
    """
    figure = Figure(figsize=(5 * len(parts), 4.6), layout="constrained", dpi=_DPI)
    panels = figure.subplots(1, len(parts), sharey=True, squeeze=False)[0]
    for panel, (part, title) in zip(panels, parts.items(), strict=True):
        for index, lamp in enumerate(dict.fromkeys(lamp for lamp, _ in lines)):
            line, colour = lines[lamp, part], f"C{index}"
            known = [(x, y) for x, y in enumerate(line.speedups) if y is not None]
            style = "^--" if line.at_least else "o-"
            label = f"{lamp} (at {line.level:.3g}{', at least' if line.at_least else ''})"
            if known:
                panel.plot(*zip(*known, strict=True), style, color=colour, label=label)
            if part == next(iter(parts)):
                panel.plot(
                    [_PRINTED], [paper[lamp]], "D", color=colour, markersize=5, clip_on=False
                )
        panel.set_xticks([_PRINTED, *range(len(methods))])
        panel.set_xticklabels(
            ["as printed in\nthe paper", *(_LABELS[name] for name in methods)], fontsize=8
        )
        panel.set(yscale="log", title=title, xlim=(_PRINTED - 0.4, len(methods) - 0.6))
        panel.axhline(1, color="grey", linewidth=0.8)
        panel.yaxis.set_major_formatter(FormatStrFormatter("%g"))
        panel.grid(alpha=0.3, which="both")
        if panel.get_legend_handles_labels()[0]:
            panel.legend(fontsize=8)
    panels[0].set_ylabel("speed-up over the explicit lamp at equal rmse_display")
    stream = io.BytesIO()
    FigureCanvasAgg(figure).print_jpg(stream, pil_kwargs={"quality": 88})
    path.parent.mkdir(parents=True, exist_ok=True)
    write_bytes(path, stream.getvalue())
