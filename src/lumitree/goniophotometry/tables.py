"""Tables of photometric figures as text, for reports and the command line."""

from collections.abc import Sequence

from lumitree.goniophotometry.figures import PLANES, Estimate, PhotometricFigures
from lumitree.goniophotometry.near_field import NearFieldLimit

NEAR_FIELD_HEADER = ("direction", "intensity", "far field from", "difference at 5 x the size")


def figure_rows(
    figures: PhotometricFigures, size: Sequence[float], step: float, rays: int
) -> list[tuple[str, str]]:
    """Names and values of the figures.

    Args:
        figures: the figures.
        size: [3] sides of the bounding box, m.
        step: of the angles, degrees.
        rays: number of rays.
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
        ("colour temperature", "not defined" if temperature is None else f"{temperature} K"),
        ("Duv", "not defined" if figures.duv is None else str(figures.duv)),
        ("size of the bounding box", " x ".join(f"{side:.4g}" for side in size) + " m"),
        ("angular step", f"{step:g}°"),
        ("rays", f"{rays:,}"),
    ]
    return rows


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
