"""Report of a measurement: polar and isocandela plot, figures, near-field limits; PDF or HTML."""

import base64
import html
import os
from collections.abc import Callable
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from matplotlib.ticker import MaxNLocator
from numpy.typing import NDArray

from lumitree.core.files import write_bytes
from lumitree.errors import shown
from lumitree.formats.type_c import Grid
from lumitree.measure.photometry.figures import PLANES, PhotometricData, plane_curve
from lumitree.measure.photometry.tables import (
    NEAR_FIELD_HEADER,
    UGR_HEADER,
    figure_rows,
    known_rows,
    near_field_rows,
    ugr_rows,
)
from lumitree.rendering.drawing import Sheet, pdf_file, text_page

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
    "Far field: distance from the centre of the luminous opening from which on the illuminance is "
    "within 5 % of intensity / distance², in a cone of 5 degrees. At shorter distances a "
    "photometric file is wrong by more; use the asset instead.",
)
_COLOUR_NOTE = (
    "Colour rendering is that of the spectrum of the bare emitters. Glass, shades and a gain shift "
    "the colour by the distance that is stated; above about 0.003 the light that leaves renders "
    "colours differently."
)
_UGR_TITLE = "UGR: five columns crosswise, five endwise"
_UGR_NOTE = (
    "Unified Glare Rating by CIE 117:1995 and CIE 190:2010, for a ceiling of equal luminaires, a "
    "quarter of their height above the eye apart. Columns: reflectances of ceiling, walls and "
    "floor in percent; rooms: sides across and along the line of sight in heights H. Only the "
    "intensities from C = 0 to 90 degrees are used, and the luminous area is the opening's. "
    "It says little of lamps that do not hang in rows."
)


def plots_png(data: PhotometricData) -> bytes:
    """Polar plot and isocandela plot as a PNG file."""
    figure = Sheet(figsize=(11.0, 4.6), dpi=110, layout="constrained")
    _polar(figure.add_subplot(1, 2, 1, projection="polar"), data)
    _isocandela(figure, figure.add_subplot(1, 2, 2), data)
    return figure.png()


def write_pdf(path: str | os.PathLike[str], data: PhotometricData) -> None:
    """Write the report as a PDF file of A4 pages: one, or two with glare ratings."""
    title = f"Photometric report: {shown(data.distribution.name)}"
    near_field = [NEAR_FIELD_HEADER, *near_field_rows(data.near_field)]
    page = text_page(title, 0.6, [_figure_rows(data), near_field], _notes(data))
    _polar(page.add_axes((0.08, 0.65, 0.36, 0.245), projection="polar"), data)
    _isocandela(page, page.add_axes((0.56, 0.66, 0.36, 0.225)), data)
    pages = [page]
    if data.ugr is not None:
        pages.append(text_page(_UGR_TITLE, 0.92, [[UGR_HEADER, *ugr_rows(data.ugr)]], [_UGR_NOTE]))
    write_bytes(path, pdf_file(pages))


def write_html(path: str | os.PathLike[str], data: PhotometricData) -> None:
    """Write the report as an HTML file that loads nothing."""
    name = html.escape(shown(data.distribution.name))
    image = base64.b64encode(plots_png(data)).decode()
    notes = "\n".join(f'<p class="note">{html.escape(note)}</p>' for note in _notes(data))
    text = f"""<!doctype html>
<html lang="en">
<meta charset="utf-8">
<meta name="viewport" content="width=device-width">
<title>Photometric report: {name}</title>
<style>{_STYLE}</style>
<h1>Photometric report: {name}</h1>
<img alt="polar plot and isocandela plot" src="data:image/png;base64,{image}">
<h2>Figures</h2>
{_html_table(_figure_rows(data))}
<h2>Far field</h2>
{_html_table(near_field_rows(data.near_field), NEAR_FIELD_HEADER)}
{_html_ugr(data.ugr)}
{notes}
</html>
"""
    write_bytes(path, text.encode())


def _html_ugr(ugr: NDArray[np.float64] | None) -> str:
    if ugr is None:
        return ""
    table = _html_table(ugr_rows(ugr), UGR_HEADER)
    return f'<h2>{_UGR_TITLE}</h2>\n{table}\n<p class="note">{html.escape(_UGR_NOTE)}</p>'


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


def _isocandela(figure: Figure, axes: Any, data: PhotometricData) -> None:
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
