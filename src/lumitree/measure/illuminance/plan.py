"""Plans of illuminance: false colours, isolux lines and values; PNG or PDF."""

import dataclasses
import io
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.backends.backend_pdf import PdfPages
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lumitree.core.text import any_characters
from lumitree.errors import shown
from lumitree.measure.illuminance.areas import Receivers
from lumitree.measure.illuminance.figures import AreaFigures

# Values are written at the points of an area if there are no more of them.
_MAX_VALUES = 300
_LEVELS, _MAP, _DPI = 10, "viridis", 130
# Inches: width of a plan in a PNG file; and A4.
_WIDTH, _PAGE = 7.0, (8.27, 11.69)
_NOTE = (
    "Illuminance in lux, with all reflections unless it says direct. U0 is the smallest over the "
    "mean, Ud the smallest over the largest illuminance of the points. Seen with the normal "
    "towards the viewer."
)


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """What is drawn of an area.

    Attributes:
        area: its figures.
        receivers: where its illuminance is known.
        lux, error, direct: [N] illuminance, its standard error, and its direct part, lx.
    """

    area: AreaFigures
    receivers: Receivers
    lux: NDArray[np.float64]
    error: NDArray[np.float64]
    direct: NDArray[np.float64]

    @property
    def height(self) -> float:
        """Inches of the plan in a PNG file."""
        plane = self.receivers.plane
        sides = np.ptp(self.receivers.flat(), axis=0) if plane is None else plane.extent
        return float(np.clip(_WIDTH * 0.8 * sides[1] / max(sides[0], 1e-9), 1.5, 9)) + 0.9


@any_characters()
def plan_png(plans: Sequence[Plan], direct_only: bool) -> bytes:
    """The plans of areas, one below the other, as a PNG file.

    Args:
        plans: what is drawn.
        direct_only: whether the illuminance is the direct part alone.
    """
    heights = [plan.height for plan in plans]
    figure = Figure(figsize=(_WIDTH, sum(heights)), layout="constrained")
    axes = figure.subplots(len(plans), 1, squeeze=False, height_ratios=heights)[:, 0]
    for each, plan in zip(axes, plans, strict=True):
        _draw(figure, each, plan, direct_only)
    stream = io.BytesIO()
    figure.savefig(stream, format="png", dpi=_DPI)
    return stream.getvalue()


@any_characters()
def plan_pdf(plans: Sequence[Plan], direct_only: bool) -> bytes:
    """A page for each area with its plan and a table, as a PDF file; arguments as `plan_png`."""
    stream = io.BytesIO()
    with PdfPages(stream) as file:
        for plan in plans:
            figure = Figure(figsize=_PAGE)
            title = f"Illuminance: {shown(plan.area.name, 60)}"
            figure.text(0.08, 0.95, title, fontsize=15, parse_math=False)
            _draw(figure, figure.add_axes((0.1, 0.42, 0.8, 0.48)), plan, direct_only)
            _table(figure, plan)
            figure.text(0.08, 0.06, _NOTE, fontsize=7.5, color="#57534e", wrap=True)
            file.savefig(figure)
    return stream.getvalue()


def _draw(figure: Figure, axes: Any, plan: Plan, direct_only: bool) -> None:
    place, largest = plan.receivers.flat(), _largest(plan)
    kind = "direct illuminance" if direct_only else "illuminance"
    axes.set_title(f"{shown(plan.area.name, 60)}: {kind}, lx", fontsize=10, parse_math=False)
    axes.set_aspect("equal")
    axes.tick_params(labelsize=7)
    for set_label, axis in zip(
        (axes.set_xlabel, axes.set_ylabel), plan.receivers.axes, strict=True
    ):
        set_label(f"from the centre along {_axis_name(axis)}", fontsize=7)
    axes.set_facecolor("#a8a29e")
    levels = MaxNLocator(_LEVELS).tick_values(0, largest)
    limits = {"vmin": 0, "vmax": levels[-1], "cmap": _MAP}
    plane = plan.receivers.plane
    if plane is None:
        colours = axes.scatter(*place.T, c=plan.lux, s=12, **limits)
    else:
        right, top = np.asarray(plane.extent) / 2
        sides = (-right, right, -top, top)
        grid = plan.lux.reshape(plane.shape)
        colours = axes.imshow(
            grid, origin="lower", extent=sides, interpolation=_smooth(grid), **limits
        )
        if min(plane.shape) > 1 and plan.area.largest > plan.area.smallest:
            u, v = place.reshape(*plane.shape, 2).transpose(2, 0, 1)
            lines = axes.contour(u, v, grid, levels=levels, colors="white", linewidths=1.0)
            if plan.area.count > _MAX_VALUES:
                axes.clabel(lines, fontsize=7, fmt="%g")
    if plan.area.count <= _MAX_VALUES:
        _values(axes, place, plan.lux, largest)
    bar = figure.colorbar(colours, ax=axes, shrink=0.8)
    bar.ax.tick_params(labelsize=7)
    bar.set_label("lx", fontsize=8)


def _smooth(grid: NDArray[np.float64]) -> str:
    """How values are interpolated: not at all where some are missing, which would spread."""
    return "nearest" if np.isnan(grid).any() else "bilinear"


def _largest(plan: Plan) -> float:
    """The largest illuminance of a plan, or 1 lx where there is none."""
    return plan.area.largest if plan.area.largest > 0 else 1.0


def _axis_name(axis: NDArray[np.float64]) -> str:
    """A direction [3] of the scene: an axis, or three numbers."""
    along = int(np.abs(axis).argmax())
    if abs(axis[along]) > 1 - 1e-6:
        return ("-" if axis[along] < 0 else "") + "xyz"[along]
    return "({:.2g}, {:.2g}, {:.2g})".format(*axis)


def _values(
    axes: Any, place: NDArray[np.float64], lux: NDArray[np.float64], largest: float
) -> None:
    """The illuminance at each point, in a colour that is seen on the plan."""
    size = float(np.clip(90 / np.sqrt(len(lux)), 3.5, 7))
    for (u, v), value in zip(place, lux, strict=True):
        if np.isnan(value):
            continue
        colour = "#111111" if value > 0.6 * largest else "#e7e5e4"
        axes.text(u, v, f"{value:.3g}", fontsize=size, ha="center", va="center", color=colour)


def _table(figure: Figure, plan: Plan) -> None:
    area = plan.area
    known = np.isfinite(plan.direct)
    mean = float(plan.direct[known].mean()) if known.any() else np.nan
    rows = [
        ("points", f"{area.count:,}" + (f", {area.enclosed:,} in solids" if area.enclosed else "")),
        ("mean", f"{area.mean:.4g} lx ± {area.mean_error:.2g}"),
        ("smallest", f"{area.smallest:.4g} lx"),
        ("largest", f"{area.largest:.4g} lx"),
        ("uniformity U0", f"{area.uniformity:.3f}"),
        ("diversity Ud", f"{area.diversity:.3f}"),
        ("mean of the direct part", f"{mean:.4g} lx"),
        ("largest standard error of a point", f"{max(plan.error[known], default=np.nan):.2g} lx"),
    ]
    for line, (name, value) in enumerate(rows):
        y = 0.36 - 0.026 * line
        figure.text(0.1, y, name, fontsize=9, color="#57534e")
        figure.text(0.5, y, value, fontsize=9)
