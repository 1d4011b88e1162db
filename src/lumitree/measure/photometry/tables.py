"""Tables of photometric figures as text, for reports and the command line."""

from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lumitree.measure.photometry.colour import RenderingIndices
from lumitree.measure.photometry.figures import PLANES, Estimate, PhotometricFigures
from lumitree.measure.photometry.near_field import NearFieldLimit
from lumitree.measure.photometry.ugr import CATALOGUE_ROOM, REFLECTANCES, ROOMS

NEAR_FIELD_HEADER = ("direction", "intensity in 5°", "far field from", "difference at 5 x the size")
UGR_HEADER = ("room", *REFLECTANCES, *REFLECTANCES)
_NEEDS_UGR = "needs the package eulumdat-ugr: pip install 'lumitree[ugr]'"
_NEEDS_COLOUR = "needs the package colour-science: pip install 'lumitree[colour]'"


def figure_rows(
    figures: PhotometricFigures,
    size: Sequence[float],
    step: float,
    rays: int,
    ugr: NDArray[np.float64] | None,
) -> list[tuple[str, str]]:
    """Names and values of the figures.

    Args:
        figures: the figures.
        size: [3] sides of the bounding box, m.
        step: of the angles, degrees.
        rays: number of rays.
        ugr: table of glare ratings, as `PhotometricData.ugr`.
    """
    up = figures.upward_share
    rows = [("luminous flux", f"{figures.lumens} lm")]
    if figures.emitted_lumens is not None and figures.light_output_ratio is not None:
        rows += [
            ("flux of the bare emitters", f"{figures.emitted_lumens} lm"),
            ("light output ratio", f"{_percent(figures.light_output_ratio)} %"),
        ]
    rows += [
        (
            "largest intensity",
            f"{figures.max_candela} cd at C = {figures.max_c:g}°, gamma = {figures.max_gamma:g}°",
        ),
        ("upward share of the flux", f"{_percent(up)} %"),
        ("downward share", f"{_percent(Estimate(1 - up.value, up.error))} %"),
    ]
    for name in PLANES:
        rows.append((f"beam angle {name} (50 %)", f"{figures.beam_angles[name]}°"))
        rows.append((f"field angle {name} (10 %)", f"{figures.field_angles[name]}°"))
    temperature = figures.colour_temperature
    rows += [
        ("colour temperature", "not known" if temperature is None else f"{temperature} K"),
        ("Duv", "not known" if figures.duv is None else str(figures.duv)),
        *_colour_rows(figures),
        ("UGR, 4H x 8H, 70/50/20", _NEEDS_UGR if ugr is None else _catalogue_ugr(ugr)),
        ("luminous opening", str(figures.opening)),
        ("centre of the opening", f"{_place(figures)} m from the centre of the bounding box"),
        ("size of the bounding box", " x ".join(f"{side:.4g}" for side in size) + " m"),
        ("angular step", f"{step:g}°"),
        ("rays", f"{rays:,}"),
    ]
    return rows


def known_rows(rows: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """`figure_rows` without those that say which package is missing here, for other readers."""
    return [row for row in rows if row[1] not in (_NEEDS_UGR, _NEEDS_COLOUR)]


def _place(figures: PhotometricFigures) -> str:
    # Plus 0: no negative zero.
    return ", ".join(f"{round(each, 4) + 0.0:.4g}" for each in figures.opening_centre)


def _colour_rows(figures: PhotometricFigures) -> list[tuple[str, str]]:
    """Rows of the bare emitters' spectrum, or one that says why there are none."""
    colour, share = figures.emitted_colour, figures.spectrum_share
    if colour is None:
        why = "the emitters have RGB colours, no spectrum"
        if share > 0:
            why = f"emitters with {1 - share:.1%} of the flux have RGB colours, no spectrum"
        return [("colour rendering", f"not known: {why}")]
    kelvin = colour.colour_temperature
    cct = "not defined" if kelvin is None else f"{kelvin:,.0f} K"
    return [
        ("CCT of the emitters", f"{cct}, Duv {colour.duv:.4f}, by their spectrum"),
        *([] if kelvin is None else _rendering_rows(colour.rendering)),
        ("colour shift by the lamp", f"{colour.shift:.4f} in (u', v')"),
    ]


def _rendering_rows(rendering: RenderingIndices | None) -> list[tuple[str, str]]:
    cri, tm30 = "CRI of the emitters", "TM-30 of the emitters"
    if rendering is None:
        return [(cri, _NEEDS_COLOUR), (tm30, _NEEDS_COLOUR)]
    return [
        (cri, f"Ra {rendering.ra:.0f}, R9 {rendering.r9:.0f}"),
        (tm30, f"Rf {rendering.rf:.0f}, Rg {rendering.rg:.0f}"),
    ]


def _catalogue_ugr(ugr: NDArray[np.float64]) -> str:
    crosswise, endwise = ugr[CATALOGUE_ROOM, [0, len(REFLECTANCES)]]
    return f"{_rating(crosswise)} crosswise, {_rating(endwise)} endwise"


def ugr_rows(ugr: NDArray[np.float64]) -> list[tuple[str, ...]]:
    """Rows of the columns `UGR_HEADER`."""
    return [
        (f"{x}H x {y}H", *(_rating(value) for value in row))
        for (x, y), row in zip(ROOMS, ugr, strict=True)
    ]


def _rating(value: float) -> str:
    # Plus 0: no negative zero.
    return f"{round(value, 1) + 0.0:.1f}" if np.isfinite(value) else "none"


def near_field_rows(limits: Sequence[NearFieldLimit]) -> list[tuple[str, str, str, str]]:
    """Rows of the columns `NEAR_FIELD_HEADER`."""
    return [
        (
            limit.direction,
            f"{limit.candela:.4g} cd",
            _distance(limit),
            _difference(limit),
        )
        for limit in limits
    ]


def _distance(limit: NearFieldLimit) -> str:
    if limit.distance is not None:
        return f"{limit.distance:.3g} m"
    return "beyond 30 x the size" if limit.is_known else "too few rays"


def _difference(limit: NearFieldLimit) -> str:
    if limit.difference is None or limit.difference_error is None:
        return "dark"
    return f"{_percent(Estimate(limit.difference, limit.difference_error))} %"


def _percent(estimate: Estimate) -> Estimate:
    return Estimate(100 * estimate.value, 100 * estimate.error)
