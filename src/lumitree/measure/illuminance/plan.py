"""Plans of illuminance: false colours, isolux lines and values; PNG or PDF."""

import dataclasses
from collections.abc import Sequence
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lumitree.errors import shown
from lumitree.measure.illuminance.areas import Receivers
from lumitree.measure.illuminance.figures import AreaFigures
from lumitree.rendering.drawing import Sheet, pdf_file, text_page

# Values are written at the points of an area if there are no more of them.
_MAX_VALUES = 300
_WIDTH, _DPI = 7.0, 130  # inches and dots per inch of a PNG file
_NOTE = (
    "Illuminance in lux, with all reflections unless it says direct. U0 is the smallest over the "
    "mean, Ud the smallest over the largest illuminance of the points. Seen with the normal "
    "towards the viewer."
)


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """The drawn parts of an area.

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


def plan_png(plans: Sequence[Plan], direct_only: bool) -> bytes:
    """The plans of areas, one below the other, as a PNG file."""
    heights = [plan.height for plan in plans]
    figure = Sheet(figsize=(_WIDTH, sum(heights)), dpi=_DPI, layout="constrained")
    axes = figure.subplots(len(plans), 1, squeeze=False, height_ratios=heights)[:, 0]
    for each, plan in zip(axes, plans, strict=True):
        _draw(figure, each, plan, direct_only)
    return figure.png()


def plan_pdf(plans: Sequence[Plan], direct_only: bool) -> bytes:
    """A page for each area with its plan and a table, as a PDF file; arguments as `plan_png`."""
    pages = []
    for plan in plans:
        title = f"Illuminance: {shown(plan.area.name, 60)}"
        page = text_page(title, 0.36, [_rows(plan)], [_NOTE])
        _draw(page, page.add_axes((0.1, 0.42, 0.8, 0.48)), plan, direct_only)
        pages.append(page)
    return pdf_file(pages)


def _draw(figure: Figure, axes: Any, plan: Plan, direct_only: bool) -> None:
    place, area, plane = plan.receivers.flat(), plan.area, plan.receivers.plane
    kind = "direct illuminance" if direct_only else "illuminance"
    axes.set_title(f"{shown(area.name, 60)}: {kind}, lx", fontsize=10, parse_math=False)
    axes.set_aspect("equal")
    right, up = (_axis_name(axis) for axis in plan.receivers.axes)
    axes.set(xlabel=f"from the centre along {right}", ylabel=f"from the centre along {up}")
    axes.set_facecolor("#a8a29e")
    levels = MaxNLocator(10).tick_values(0, area.largest if area.largest > 0 else 1.0)
    limits = {"vmin": 0, "vmax": levels[-1]}
    if plane is None:
        colours = axes.scatter(*place.T, c=plan.lux, s=12, **limits)
    else:
        half, grid = np.asarray(plane.extent) / 2, plan.lux.reshape(plane.shape)
        sides = (-half[0], half[0], -half[1], half[1])
        # Interpolation would spread values that are missing.
        smooth = "nearest" if np.isnan(grid).any() else "bilinear"
        colours = axes.imshow(grid, origin="lower", extent=sides, interpolation=smooth, **limits)
        if min(plane.shape) > 1 and area.largest > area.smallest:
            u, v = place.reshape(*plane.shape, 2).transpose(2, 0, 1)
            lines = axes.contour(u, v, grid, levels=levels, colors="white", linewidths=1.0)
            if area.count > _MAX_VALUES:
                axes.clabel(lines, fontsize=7, fmt="%g")
    if area.count <= _MAX_VALUES:
        _values(axes, place, plan)
    figure.colorbar(colours, ax=axes, shrink=0.8, label="lx")


def _axis_name(axis: NDArray[np.float64]) -> str:
    """A direction [3] of the scene: an axis, or three numbers."""
    along = int(np.abs(axis).argmax())
    if abs(axis[along]) > 1 - 1e-6:
        return ("-" if axis[along] < 0 else "") + "xyz"[along]
    return "({:.2g}, {:.2g}, {:.2g})".format(*axis)


def _values(axes: Any, place: NDArray[np.float64], plan: Plan) -> None:
    """The illuminance at each point, in a colour that is seen on the plan."""
    size = float(np.clip(90 / np.sqrt(plan.area.count), 3.5, 7))
    style = {"fontsize": size, "ha": "center", "va": "center"}
    for (u, v), value in zip(place, plan.lux, strict=True):
        if np.isfinite(value):
            colour = "#111111" if value > 0.6 * plan.area.largest else "#e7e5e4"
            axes.text(u, v, f"{value:.3g}", color=colour, **style)


def _rows(plan: Plan) -> list[tuple[str, str]]:
    """Names and values of the figures of an area."""
    area = plan.area
    known = np.isfinite(plan.direct)
    mean = float(plan.direct[known].mean()) if known.any() else np.nan
    return [
        ("points", f"{area.count:,}" + (f", {area.enclosed:,} in solids" if area.enclosed else "")),
        ("mean", f"{area.mean:.4g} lx ± {area.mean_error:.2g}"),
        ("smallest", f"{area.smallest:.4g} lx"),
        ("largest", f"{area.largest:.4g} lx"),
        ("uniformity U0", f"{area.uniformity:.3f}"),
        ("diversity Ud", f"{area.diversity:.3f}"),
        ("mean of the direct part", f"{mean:.4g} lx"),
        ("largest standard error of a point", f"{max(plan.error[known], default=np.nan):.2g} lx"),
    ]
