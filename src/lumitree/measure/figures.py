"""Figures of this package: contact sheets of views and irradiance, plans, photometric reports.

Contact sheets show views and irradiance of an evaluation. Plans show illuminance in false colours,
with isolux lines and values. Reports have a polar, a cone and an isocandela plot, figures and
near-field limits, as PDF or HTML.
"""

import base64
import dataclasses
import html
import os
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import numpy as np
from matplotlib import colormaps
from matplotlib.axes import Axes
from matplotlib.colors import LogNorm, Normalize, to_rgba
from matplotlib.figure import Figure
from matplotlib.patches import Patch
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lumitree.core.files import write_bytes
from lumitree.core.images import auto_exposure, tonemap
from lumitree.errors import shown
from lumitree.formats.type_c import Grid
from lumitree.measure.floor_plan import FloorPlan
from lumitree.measure.irradiance import FACES, NUM_CUBE_FACES, IrradianceEvaluation
from lumitree.measure.photometric_figures import (
    BEAM,
    NEAR_FIELD_HEADER,
    PLANES,
    UGR_HEADER,
    Estimate,
    PhotometricData,
    figure_rows,
    half_widths,
    known_rows,
    near_field_rows,
    plane_curve,
    ugr_rows,
)
from lumitree.measure.receivers import AreaFigures, Receivers
from lumitree.rendering.drawing import (
    OPACITY,
    ColourScale,
    Sheet,
    Tile,
    image_grid,
    pdf_file,
    text_page,
)

# Most views of a contact sheet.
MAX_ROWS = 6
# Pixels of an image of a view, and of a face.
_VIEW, _FACE = 320, 216
# Smaller relative errors are black.
_ERROR = ColourScale(LogNorm(1e-4, 1, clip=True), "inferno", "|baked - reference| / L_max")
_DIFFERENCE = ColourScale(Normalize(-0.2, 0.2, clip=True), "RdBu_r", "baked / explicit - 1")
# Part of the patches that may be brighter than the scale: patches that rare paths reach are noisy.
_CLIPPED = 0.002
# Illuminance plans write values at the points of an area if there are no more of them.
_MAX_VALUES = 300
_WIDTH, _DPI = 7.0, 130  # inches and dots per inch of a PNG file of plans
_PLAN_NOTE = (
    "Illuminance in lux, with all reflections unless it says direct. U0 is the smallest over the "
    "mean, Ud the smallest over the largest illuminance of the points. Seen with the normal "
    "towards the viewer; coordinates of the scene. Lines: surfaces that cross the plane, and steps "
    "of the surfaces below it."
)
_SECTION, _EDGES, _LAMPS, _ENCLOSED = "#1c1917", "#44403c", "#f97316", "#a8a29e"
_LUX = colormaps["viridis"].with_extremes(bad=_ENCLOSED)
# Maps of lamps side by side.
_MAPS_ACROSS = 4
# Degrees from the axis up to which light is drawn as a cone.
_WIDEST = 85
_COLOURS = {"C0-C180": "#1f4e9c", "C90-C270": "#c2410c"}
_STYLE = """
body { font: 15px/1.5 system-ui, sans-serif; max-width: 62rem; margin: 2rem auto; padding: 0 1rem;
       color: #1c1917; background: #fff; }
table { border-collapse: collapse; margin: 0.5rem 0 1.5rem; }
td, th { padding: 0.2rem 1.2rem 0.2rem 0; text-align: left; border-bottom: 1px solid #e7e5e4;
         font-weight: normal; }
th { color: #57534e; }
img { max-width: 100%; }
p.note { color: #57534e; max-width: 45rem; }
"""
_NOTES = (
    "C = 0 is towards +x of the luminaire's file and C is counter-clockwise seen from above; "
    "gamma = 0 is straight down. Errors are standard errors.",
    "Luminance: intensity over the area of the luminous opening seen from there. Cone: illuminance "
    "on its axis, by intensity / distance², and widths in C0-C180 and C90-C270; at its edge the "
    "intensity is half of the intensity on the axis.",
)
_FAR_NOTE = (
    "Far field: distance from the centre of the luminous opening from which on the illuminance is "
    "within 5 % of intensity / distance², in a cone of 5 degrees. At shorter distances a "
    "photometric file is wrong by more; use the asset instead. Too few rays: trace more (--paths)."
)
_COLOUR_NOTE = (
    "Colour rendering is computed from the spectrum of the bare emitters. Glass, shades and "
    "factors on the light shift the colour by the distance that is stated; above about 0.003 the "
    "light that leaves renders colours differently."
)
_UGR_TITLE = "UGR: five columns crosswise, five endwise"
_UGR_NOTE = (
    "Unified Glare Rating by CIE 117:1995 and CIE 190:2010, for a ceiling of equal luminaires, a "
    "quarter of their height above the eye apart. Columns: reflectances of ceiling, walls and "
    "floor in percent; rooms: sides across and along the line of sight in heights H. Only the "
    "intensities from C = 0 to 90 degrees are used, and the luminous area is the opening's. "
    "It says little of lamps that do not hang in rows."
)


@dataclasses.dataclass(frozen=True)
class SheetRow:
    """One view of a sheet.

    Attributes:
        reference: [H, W, 3] radiance of the luminaire.
        baked: [H, W, 3] radiance of the asset, same unit.
        reference_opacity: [H, W] in [0, 1].
        baked_opacity: [H, W] in [0, 1].
        metrics: at least `psnr_linear` (dB) and `opacity_rmse` of this view.
    """

    name: str
    reference: NDArray[np.floating]
    baked: NDArray[np.floating]
    reference_opacity: NDArray[np.floating]
    baked_opacity: NDArray[np.floating]
    metrics: Mapping[str, float]

    def tiles(self, max_radiance: float) -> list[Tile]:
        """Images of the columns of `draw_sheet`; the reference decides the exposure of both."""
        exposure, metrics = auto_exposure(self.reference), self.metrics
        error = np.abs(self.baked - self.reference).mean(axis=-1) / max_radiance
        psnr = f"psnr_linear {metrics['psnr_linear']:.2f} dB"
        if "psnr_linear_black" in metrics:
            psnr += f" (black {metrics['psnr_linear_black']:.2f})"
        return [
            Tile(tonemap(self.reference, exposure), f"{self.name} (exposure {exposure:.3g})"),
            Tile(tonemap(self.baked, exposure), psnr),
            Tile(_ERROR(error)),
            Tile(OPACITY(self.reference_opacity)),
            Tile(OPACITY(self.baked_opacity), f"opacity_rmse {metrics['opacity_rmse']:.4f}"),
        ]


def draw_sheet(rows: Sequence[SheetRow], max_radiance: float, title: str) -> Sheet:
    """Contact sheet of views.

    Columns: reference and baked radiance (sRGB, both at the reference's `auto_exposure`), their
    relative error |baked - reference| / L_max (mean over the channels) in false colour, reference
    and baked opacity in grey.

    Args:
        rows: 1 to 6 views, shown in this order.
        max_radiance: L_max, radiance unit, positive.
        title: one line above the sheet, e.g. luminaire and asset.
    """
    return image_grid(
        [row.tiles(max_radiance) for row in rows],
        _VIEW,
        title=title,
        columns=("Reference", "Baked", "Error", "Reference opacity", "Baked opacity"),
        bars={2: _ERROR, 3: OPACITY, 4: OPACITY},
    )


def draw_irradiance(evaluation: IrradianceEvaluation, title: str) -> Sheet:
    """Sheet with a column for each face, and explicit, baked and the difference of both in rows.

    Explicit and baked irradiance have one colour scale for the faces of the cube, and one for the
    plane that touches the bounding box. The difference is relative to the explicit irradiance of
    each patch, and grey where this is 0.

    Args:
        title: one line above the sheet, e.g. luminaire and asset.
    """
    explicit, baked, error = evaluation.explicit.lux, evaluation.baked.lux, evaluation.error
    ratio = np.divide(baked, explicit, out=np.full_like(baked, np.nan), where=explicit > 0)
    cube = _scale(explicit[:NUM_CUBE_FACES], "cube: irradiance, lx")
    touching = _scale(explicit[NUM_CUBE_FACES:], "touching: irradiance, lx")
    rows: tuple[list[Tile], ...] = ([], [], [])
    for index, face in enumerate(FACES):
        scale = cube if index < NUM_CUBE_FACES else touching
        mean = f"mean {explicit[index].mean():,.4g} lx"
        of_ratio = "ratio " + _number(error.ratio[index], error.ratio_error[index], ".3f")
        of_rms = "RMS error " + _number(error.rms[index], error.rms_error[index], ".1%")
        rows[0].append(Tile(scale(_seen(face, explicit[index])), mean))
        rows[1].append(Tile(scale(_seen(face, baked[index])), of_ratio))
        rows[2].append(Tile(_DIFFERENCE(_seen(face, ratio[index]) - 1), of_rms))
    return image_grid(
        rows,
        _FACE,
        title=title,
        subtitle="irradiance on a cube of three times the size of the bounding box, faces as seen "
        "from the lamp, and on a plane that touches the box from below; "
        f"{evaluation.num_paths:,} paths each",
        columns=[*(f"face {face}" for face in FACES[:NUM_CUBE_FACES]), "touching plane"],
        names=("explicit", "baked", "difference"),
        bars={1: cube, 3: _DIFFERENCE, 6: touching},
    )


def _scale(lux: NDArray[np.float64], label: str) -> ColourScale:
    largest = float(np.quantile(lux, 1 - _CLIPPED)) or float(lux.max()) or 1.0
    return ColourScale(Normalize(0, largest, clip=True), "viridis", label)


def _seen(face: str, patches: NDArray[np.float64]) -> NDArray[np.float64]:
    """Patches [P, P] of a face as an image, as seen from the lamp with +y up.

    -y and the touching plane have -z up, +y has +z up, as the views of `preview` from above and
    from below.
    """
    if face in ("-x", "+x"):
        image = patches[::-1]
    elif face in ("-y", "touching"):
        image = patches.T
    else:
        image = patches.T[::-1]
    return image[:, ::-1] if face in ("-x", "+z") else image


def _number(value: float, error: float, form: str) -> str:
    if not np.isfinite(value):
        return "not known"
    return f"{value:{form}}" + (f" ± {error:{form}}" if np.isfinite(error) else "")


@dataclasses.dataclass(frozen=True, eq=False)
class Plan:
    """An area of a plan.

    Attributes:
        area: its figures.
        receivers: its points.
        lux, error, direct: [N] illuminance, its standard error, and its direct part, lx.
        floor: the room at a plane; None for other areas.
        unit: of coordinates, such as "m".
        largest: of the colours, lx; default: the largest illuminance of the area.
        by_lamp: illuminance [N] by each lamp that lights the area, lx, by name; empty if it is
            not estimated.
    """

    area: AreaFigures
    receivers: Receivers
    lux: NDArray[np.float64]
    error: NDArray[np.float64]
    direct: NDArray[np.float64]
    floor: FloorPlan | None
    unit: str
    largest: float | None = None
    by_lamp: Mapping[str, NDArray[np.float64]] = dataclasses.field(default_factory=dict)

    @property
    def height(self) -> float:
        """Inches in a PNG file."""
        flat, floor = self.receivers.flat(), self.floor
        sides = np.ptp(flat, axis=0) if floor is None else floor.high - floor.low
        return float(np.clip(_WIDTH * 0.8 * sides[1] / max(sides[0], 1e-9), 1.5, 9)) + 1.1

    @property
    def height_by_lamp(self) -> float:
        """Inches of the maps by lamp in a PNG file."""
        sides = np.ptp(self.receivers.flat(), axis=0)
        height = _WIDTH / _MAPS_ACROSS * float(np.clip(sides[1] / max(sides[0], 1e-9), 0.3, 2))
        return -(-len(self.by_lamp) // _MAPS_ACROSS) * (height + 0.4)


def plan_png(plans: Sequence[Plan], direct_only: bool, columns: int = 1) -> bytes:
    """The plans of areas in rows of `columns` plans, as a PNG file.

    In a single column, small maps by lamp are below each plan.
    """
    heights = [
        each for plan in plans[::columns] for each in (plan.height, plan.height_by_lamp) if each
    ]
    figure = Sheet(figsize=(columns * _WIDTH, sum(heights)), dpi=_DPI, layout="constrained")
    cells = iter(figure.add_gridspec(len(heights), columns, height_ratios=heights))
    for plan in plans:
        _draw_plan(figure, figure.add_subplot(next(cells)), plan, direct_only)
        if plan.by_lamp:
            _draw_lamps(figure, next(cells), plan)
    return figure.png()


def plan_pdf(plans: Sequence[Plan], direct_only: bool) -> bytes:
    """A page for each area with its plan and a table, as a PDF file."""
    pages = []
    for plan in plans:
        title = f"Illuminance: {shown(plan.area.name, 60)}"
        page = text_page(title, 0.36, [_plan_rows(plan)], [_PLAN_NOTE])
        _draw_plan(page, page.add_axes((0.1, 0.42, 0.8, 0.48)), plan, direct_only)
        pages.append(page)
    return pdf_file(pages)


def _draw_plan(figure: Figure, axes: Axes, plan: Plan, direct_only: bool) -> None:
    place, area, plane = plan.receivers.flat(), plan.area, plan.receivers.plane
    kind = "direct illuminance" if direct_only else "illuminance"
    figures = f"mean {area.mean:.4g} lx, U0 {area.uniformity:.2f}"
    title = f"{shown(area.name, 60)}: {kind}, {figures}"
    axes.set_title(title, fontsize=10, pad=18, parse_math=False)
    axes.set_aspect("equal")
    for axis, along in zip((axes.xaxis, axes.yaxis), plan.receivers.axes, strict=True):
        name, sign = _axis_name(along)
        axis.set_label_text(f"{name}, {plan.unit}")
        axis.set_major_formatter(lambda value, _, sign=sign: f"{sign * value + 0.0:g}")
    largest = area.largest if plan.largest is None else plan.largest
    levels = MaxNLocator(10).tick_values(0, largest if largest > 0 else 1.0)
    colours = _draw_lux(axes, plan.receivers, plan.lux, levels[-1])
    if plane is not None and min(plane.shape) > 1 and area.largest > area.smallest:
        u, v = place.reshape(*plane.shape, 2).transpose(2, 0, 1)
        grid = plan.lux.reshape(plane.shape)
        lines = axes.contour(u, v, grid, levels=levels, colors="white", linewidths=1.0)
        if area.count > _MAX_VALUES:
            axes.clabel(lines, fontsize=7, fmt="%g")
    if plan.floor is not None:
        _draw_floor(axes, plan.floor, area.enclosed > 0)
    if area.count <= _MAX_VALUES:
        size = float(np.clip(90 / np.sqrt(area.count), 3.5, 7))
        style = {"fontsize": size, "ha": "center", "va": "center"}
        for (u, v), value in zip(place, plan.lux, strict=True):
            if np.isfinite(value):
                # Legible on the colour of the plan.
                colour = "#111111" if value > 0.6 * largest else "#e7e5e4"
                axes.text(u, v, f"{value:.3g}", color=colour, **style)
    label = "illuminance, lx; isolux lines at the numbers"
    figure.colorbar(colours, ax=axes, shrink=0.8, label=label, ticks=levels)


def _draw_lux(axes: Any, receivers: Receivers, lux: NDArray[np.float64], largest: float) -> Any:
    """Illuminance in false colours, from 0 to `largest`."""
    plane, limits = receivers.plane, {"vmin": 0, "vmax": largest}
    if plane is None:
        return axes.scatter(*receivers.flat().T, c=lux, s=12, **limits)
    centre, half = receivers.axes @ plane.centre, np.array(plane.extent) / 2
    grid, sides = lux.reshape(plane.shape), np.column_stack([centre - half, centre + half]).ravel()
    # Interpolation would spread values that are missing.
    smooth = "nearest" if np.isnan(grid).any() else "bilinear"
    style = {"cmap": _LUX, "origin": "lower", "interpolation": smooth}
    return axes.imshow(grid, extent=sides, **style, **limits)


def _draw_lamps(figure: Figure, place: Any, plan: Plan) -> None:
    """A small map of the illuminance by each lamp, from 0 to its own largest value."""
    maps = place.subgridspec(-(-len(plan.by_lamp) // _MAPS_ACROSS), _MAPS_ACROSS)
    for part, (name, lux) in zip(maps, plan.by_lamp.items(), strict=False):
        axes = figure.add_subplot(part, aspect="equal", xticks=[], yticks=[])
        largest = np.nanmax(lux)
        _draw_lux(axes, plan.receivers, lux, largest)
        title = f"{shown(name, 24)}\nmean {np.nanmean(lux):.3g}, largest {largest:.3g} lx"
        axes.set_title(title, fontsize=7, pad=3, parse_math=False)


def _draw_floor(axes: Any, floor: FloorPlan, has_enclosed: bool) -> None:
    """Walls, furniture and lamps over a plan, and the legend."""
    sides = np.column_stack([floor.low, floor.high]).ravel()
    for mask, colour in ((floor.edges & ~floor.section, _EDGES), (floor.section, _SECTION)):
        image = np.zeros((*mask.shape, 4))
        image[mask] = to_rgba(colour)
        axes.imshow(image, origin="lower", extent=sides, interpolation="antialiased")
    for outline in floor.lamps:
        axes.fill(*outline.T, fill=False, edgecolor=_LAMPS, lw=1.4)
        axes.plot(*(outline.min(axis=0) + outline.max(axis=0)) / 2, "+", color=_LAMPS, ms=5)
    axes.set(xlim=sides[:2], ylim=sides[2:])
    entries = [
        (_SECTION, "section of the room", floor.section.any()),
        (_EDGES, "edges below the plane", floor.edges.any()),
        (_LAMPS, "lamp", bool(floor.lamps)),
        (_ENCLOSED, "inside a solid, not counted", has_enclosed),
    ]
    patches = [Patch(color=colour, label=label) for colour, label, is_there in entries if is_there]
    style = {"fontsize": 7, "frameon": False, "handlelength": 1}
    axes.legend(handles=patches, ncols=4, loc="lower center", bbox_to_anchor=(0.5, 1.0), **style)


def _axis_name(axis: NDArray[np.float64]) -> tuple[str, int]:
    """A direction [3] of the scene, an axis or three numbers; and the sign of the axis."""
    along = int(np.abs(axis).argmax())
    if abs(axis[along]) > 1 - 1e-6:
        return "xyz"[along], int(np.sign(axis[along]))
    return "along ({:.2g}, {:.2g}, {:.2g})".format(*axis), 1


def _plan_rows(plan: Plan) -> list[tuple[str, str]]:
    """Names and values of the figures of an area."""
    area, direct, error = plan.area, plan.direct, plan.error
    known = np.isfinite(direct)
    mean = float(direct[known].mean()) if known.any() else np.nan
    return [
        ("points", f"{area.count:,}" + (f", {area.enclosed:,} in solids" if area.enclosed else "")),
        ("mean", f"{Estimate(area.mean, area.mean_error)} lx"),
        ("smallest", f"{area.smallest:.4g} lx"),
        ("largest", f"{area.largest:.4g} lx"),
        ("uniformity U0", f"{area.uniformity:.3f}"),
        ("diversity Ud", f"{area.diversity:.3f}"),
        ("mean of the direct part", f"{mean:.4g} lx"),
        ("largest standard error of a point", f"{max(error[known], default=np.nan):.2g} lx"),
    ]


def plots_png(data: PhotometricData) -> bytes:
    """Polar plot, cone diagram and isocandela plot as a PNG file."""
    figure = Sheet(figsize=(15.0, 4.6), dpi=110, layout="constrained")
    _polar(figure.add_subplot(1, 3, 1, projection="polar"), data)
    _cone(figure.add_subplot(1, 3, 2), data.step, data.distribution.intensity)
    _isocandela(figure, figure.add_subplot(1, 3, 3), data)
    return figure.png()


def write_pdf(path: str | os.PathLike[str], data: PhotometricData) -> None:
    """Write the report as a PDF file of A4 pages: figures, and near field and glare if known."""
    name = shown(data.distribution.name)
    page = text_page(f"Photometric report: {name}", 0.62, [_figure_rows(data)], _notes(data))
    _polar(page.add_axes((0.05, 0.69, 0.26, 0.2), projection="polar"), data)
    _cone(page.add_axes((0.4, 0.69, 0.18, 0.2)), data.step, data.distribution.intensity)
    _isocandela(page, page.add_axes((0.78, 0.69, 0.18, 0.2)), data)
    tables: dict[str, tuple[list[tuple[str, ...]], str]] = {}
    if data.near_field:
        tables["far field"] = [NEAR_FIELD_HEADER, *near_field_rows(data.near_field)], _FAR_NOTE
    if data.ugr is not None:
        tables["glare"] = [UGR_HEADER, *ugr_rows(data.ugr)], f"{_UGR_TITLE}. {_UGR_NOTE}"
    pages = [page]
    if tables:
        heading = f"{' and '.join(tables).capitalize()}: {name}"
        rows, notes = zip(*tables.values(), strict=True)
        pages.append(text_page(heading, 0.92, rows, notes))
    write_bytes(path, pdf_file(pages))


def write_html(path: str | os.PathLike[str], data: PhotometricData) -> None:
    """Write the report as an HTML file that loads nothing."""
    name = html.escape(shown(data.distribution.name))
    image = base64.b64encode(plots_png(data)).decode()
    notes, far_field, ugr = _notes(data), "", ""
    if data.near_field:
        table = _html_table(near_field_rows(data.near_field), NEAR_FIELD_HEADER)
        far_field, notes = f"<h2>Far field</h2>\n{table}", (*notes, _FAR_NOTE)
    if data.ugr is not None:
        table = _html_table(ugr_rows(data.ugr), UGR_HEADER)
        ugr = f'<h2>{_UGR_TITLE}</h2>\n{table}\n<p class="note">{html.escape(_UGR_NOTE)}</p>'
    paragraphs = "\n".join(f'<p class="note">{html.escape(note)}</p>' for note in notes)
    text = f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>Photometric report: {name}</title>
<style>{_STYLE}</style>
<h1>Photometric report: {name}</h1>
<img alt="polar plot, cone diagram and isocandela plot" src="data:image/png;base64,{image}">
<h2>Figures</h2>
{_html_table(_figure_rows(data))}
{far_field}
{ugr}
{paragraphs}
</html>
"""
    write_bytes(path, text.encode())


def _notes(data: PhotometricData) -> tuple[str, ...]:
    return _NOTES if data.figures.emitted_colour is None else (*_NOTES, _COLOUR_NOTE)


def _figure_rows(data: PhotometricData) -> list[tuple[str, str]]:
    rows = figure_rows(data.figures, data.size.tolist(), data.step, data.num_rays, data.ugr)
    return known_rows(rows)


def _polar(axes: Any, data: PhotometricData) -> None:
    """Intensity in two vertical planes, straight down at the bottom."""
    grid = Grid(data.step)
    for name, c in PLANES.items():
        curve = plane_curve(grid, data.distribution.intensity, c)
        angle = np.deg2rad(np.arange(len(curve) + 1) * data.step)
        axes.plot(angle, np.append(curve, curve[0]), color=_COLOURS[name], label=name, lw=1.4)
    axes.set_theta_zero_location("S")
    axes.set_theta_direction(1)
    # The side of C is on the right.
    ticks = np.arange(0, 360, 30)
    axes.set_xticks(np.deg2rad(ticks), [f"{min(tick, 360 - tick)}°" for tick in ticks])
    axes.tick_params(labelsize=8)
    axes.set_ylim(0, None)
    axes.set_title("intensity, cd", fontsize=10, pad=16)
    for x, text in ((0.0, "C180, C270"), (1.0, "C0, C90")):
        axes.text(
            x, -0.06, text, transform=axes.transAxes, fontsize=8, color="#57534e", ha="center"
        )
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), ncols=2, fontsize=8, frameon=False)


def _cone(axes: Axes, step: float, intensity: NDArray[np.float64]) -> None:
    """Cone around the axis with the more light, in which the intensity is at least half of its."""
    down, up = intensity[:, 0].mean(), intensity[:, -1].mean()
    is_up = up > down
    axes.set_title(f"cone straight {'up' if is_up else 'down'}", fontsize=10, pad=16)
    axes.set(xlim=(-5, 5), ylim=(0, 5.5) if is_up else (5.5, 0), xticks=range(-4, 5, 2))
    axes.set_yticks(range(1, 6), [f"{each} m" for each in range(1, 6)])
    axes.tick_params(labelsize=8)
    axes.grid(axis="y", color="#a8a29e", lw=0.6)
    sides: list[float | None] = []
    for name, c in PLANES.items():
        curve = plane_curve(Grid(step), intensity, c)
        half = len(curve) // 2 if is_up else 0
        angles = half_widths(np.roll(curve, -half), step, BEAM)
        right, left = np.tan(np.deg2rad(angles))
        # Wider light is in no cone.
        is_cone = max(angles) <= _WIDEST
        sides.append(right + left if is_cone else None)
        label = f"{angles[1]:.0f}° + {angles[0]:.0f}°" if is_cone else f"above {2 * _WIDEST}°"
        ends = (-5.5 * left, 0, 5.5 * right) if is_cone else (0, 0, 0)
        style = {"color": _COLOURS[name], "alpha": 0.25, "lw": 0}
        axes.fill(ends, (5.5, 0, 5.5), label=f"{name}: {label}", **style)
    for distance in range(1, 6):
        lux = f"{float(f'{max(down, up) / distance**2:.3g}'):,.12g} lx"
        size = " x ".join("wide" if s is None else f"{s * distance:.2f} m" for s in sides)
        text = lux if sides == [None, None] else f"{lux}\n{size}"
        axes.text(5.3, distance, text, fontsize=7.5, va="center")
    axes.legend(loc="upper center", bbox_to_anchor=(0.5, -0.08), fontsize=8, frameon=False)


def _isocandela(figure: Figure, axes: Axes, data: PhotometricData) -> None:
    """Lines of equal intensity over C and γ."""
    distribution = data.distribution
    c = np.append(distribution.c, 360)
    values = np.concatenate([distribution.intensity, distribution.intensity[:1]]).T
    levels = MaxNLocator(10).tick_values(0, float(values.max()) or 1.0)
    filled = axes.contourf(c, distribution.gamma, values, levels=levels, cmap="viridis")
    axes.contour(c, distribution.gamma, values, levels=levels[1:-1], colors="white", linewidths=0.4)
    axes.set_xticks(np.arange(0, 361, 90))
    axes.set_yticks(np.arange(0, 181, 30))
    axes.set_xlabel("C, degrees", fontsize=9)
    axes.set_ylabel("gamma, degrees (0: down)", fontsize=9)
    axes.tick_params(labelsize=8)
    axes.set_title("isocandela plot, cd", fontsize=10)
    bar = figure.colorbar(filled, ax=axes, ticks=levels[::2])
    bar.ax.tick_params(labelsize=8)


def _html_table(rows: Any, header: tuple[str, ...] | None = None) -> str:
    def line(cells: tuple[str, ...], tag: Callable[[int], str]) -> str:
        return "".join(f"<{tag(i)}>{html.escape(cell)}</{tag(i)}>" for i, cell in enumerate(cells))

    lines = [] if header is None else [line(header, lambda _: "th")]
    lines += [line(row, lambda i: "td" if i else "th") for row in rows]
    return "<table>\n" + "\n".join(f"<tr>{each}</tr>" for each in lines) + "\n</table>"
