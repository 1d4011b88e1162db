"""Plots of the page."""

import dataclasses
import io
from collections.abc import Mapping, Sequence
from pathlib import Path

from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure
from matplotlib.ticker import FormatStrFormatter

from lumitree.core.files import write_bytes

_LABELS = {
    "proxy": "the paper's way",
    "leaves": "+ importance\nsampling",
    "divided": "+ illumination and\nappearance divided",
}
_DPI = 110
# Where the paper's own figures are.
_PRINTED = -0.9


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
