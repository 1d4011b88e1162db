"""Intensities over the whole sphere from the planes that a photometric file holds.

Type C photometry has a vertical polar axis: see `type_c`. Of the other types only the photometric
half-space is measured, by horizontal angles H and vertical angles V from -90 to 90 degrees:

    A   the polar axis is vertical, H is the longitude about it and V the latitude. H = V = 0 is
        horizontal, towards C = 0, and V = 90 is up. So γ = 90 + V, and C = -H, since H is counted
        clockwise seen from above
    B   the polar axis is horizontal, from C = 90 to C = 270; V is the longitude about it, and H the
        latitude. H = V = 0 is down, V = 90 is towards C = 0, and H = 90 towards C = 270. V and -H
        are the angles B and β of CIE 121

Sources: section 3 of ANSI/IESNA LM-63-02, by which H = V = 0 is photometric zero, straight down, in
Type B and photometric horizontal in Type A, and H is clockwise in both; Ashdown (1998), by whom the
polar axis of Type B is that of the width of the opening; and the frames of the glTF extension
EXT_lights_ies, in the notation of IES LM-75.
"""

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeError
from lumitree.formats.type_c import IntensityDistribution, Turned, direction_of

Array = NDArray[np.float64]
# A step at the edge of the given angles, degrees: the light ends there.
EDGE = 1e-3
# Negative intensities below this part of the largest are noise of the instrument.
_NOISE = 1e-3
# Between the steps of angles that were written with few digits, degrees.
_ROUNDING = 0.1
# Step of the grid that Type B is interpolated on, degrees.
_STEP_OF_B = 1.0
# First and last plane of a file, and the planes that its symmetries reflect at, one after another.
_SYMMETRIES: dict[tuple[float, float], tuple[float, ...]] = {
    (0, 90): (90, 180),
    (0, 180): (180,),
    (180, 360): (180,),
    (90, 270): (90,),
    (-90, 90): (90,),
    (270, 450): (270,),
}


def completed(c: Array, gamma: Array, intensity: Array) -> tuple[Array, Array, Array]:
    """Angles and intensities [C, G] of the whole sphere from a Type C file's.

    One plane stands for rotational symmetry. Planes over a quarter or a half of the circle stand
    for symmetry about one or both of the planes C = 0 and C = 90. Where a file has no γ, it is
    dark. Angles are ascending, in degrees, γ within 0 to 180.
    """
    _check_ascending(c, gamma)
    if not 0 <= gamma[0] <= gamma[-1] <= 180:
        raise LumitreeError(f"its gamma angles are {_range(gamma)}; expected them within 0 to 180")
    for plane in _SYMMETRIES.get((float(c[0]), float(c[-1])), ()):
        c, intensity = _reflected(c, intensity, plane)
    if len(c) == 1:
        c = np.zeros(1)
    elif not (180 < c[-1] - c[0] <= 360 and c[0] >= -360 and c[-1] <= 720):
        raise LumitreeError(
            f"its C angles are {_range(c)}; expected one angle, 0 to 90, 180 or 360, just below "
            "360, or 90 to 270"
        )
    elif 360 - (c[-1] - c[0]) > np.diff(c).max() + _ROUNDING:
        raise LumitreeError(
            f"its C angles are {_range(c)}, in steps of at most {np.diff(c).max():g} degrees, and "
            f"there is none between {c[-1]:g} and {c[0] + 360:g}; expected the whole circle"
        )
    c, first = np.unique((c % 360).round(9) % 360, return_index=True)
    gamma, intensity = _with_edges(gamma, intensity[first], 0, 180)
    return c, gamma, intensity


def type_a(horizontal: Array, vertical: Array, intensity: Array) -> tuple[Array, Array, Array]:
    """C, γ and intensities of the whole sphere of Type A photometry, [H, V] as given.

    Angles are ascending, in degrees: H from 0 (symmetry about H = 0) or from at least -180, V from
    0 (symmetry about V = 0) or from at least -90.
    """
    _check_half_space("A", horizontal, vertical, (180, 90))
    return _about_axis(horizontal, vertical, intensity)


def turned_of_type_b(horizontal: Array, vertical: Array, intensity: Array) -> Turned:
    """Intensities of Type B photometry in its own angles; arguments as of `type_a`.

    H is within -90 to 90 and V within -180 to 180 degrees.
    """
    _check_half_space("B", horizontal, vertical, (90, 180))
    # The same angles about an axis that is vertical in Type A, and towards C = 270 here.
    native = IntensityDistribution("", *_about_axis(vertical, horizontal, intensity.T))
    return Turned(native, np.array([[0.0, -1, 0], [0, 0, 1], [1, 0, 0]]))


def _about_axis(longitude: Array, latitude: Array, intensity: Array) -> tuple[Array, Array, Array]:
    """C, γ and intensities of the whole sphere from angles about the vertical axis."""
    if longitude[0] == 0:
        longitude, intensity = _mirrored(longitude, intensity)
    if latitude[0] == 0:
        latitude, turned = _mirrored(latitude, intensity.T)
        intensity = turned.T
    c, gamma, intensity = -longitude[::-1], latitude + 90, intensity[::-1]
    gamma, intensity = _with_edges(gamma, intensity, 0, 180)
    c, turned = _with_edges(c, intensity.T, -180, 180 - EDGE)
    c, first = np.unique(c.round(9) % 360, return_index=True)
    return c, gamma, turned.T[first]


def on_grid(turned: Turned) -> tuple[Array, Array, Array]:
    """C, γ and intensities on a grid of 1 degree, with the same flux."""
    c = np.arange(0, 360, _STEP_OF_B)
    gamma = np.sort(np.append(np.arange(0, 180 + _STEP_OF_B, _STEP_OF_B), 90 + EDGE))
    found = turned.at(direction_of(c[:, None], gamma))
    lumens = IntensityDistribution("", c, gamma, found).lumens
    return c, gamma, found * (turned.distribution.lumens / lumens if lumens > 0 else 1.0)


def without_noise(intensity: Array) -> tuple[Array, float]:
    """Intensities with 0 for small negative ones, and the most negative of these.

    One more negative than 0.1 % of the largest is refused.
    """
    least, largest = float(intensity.min(initial=0)), float(intensity.max(initial=0))
    if least < -_NOISE * largest:
        raise LumitreeError(
            f"it has a negative intensity, {least:g} cd, where the largest is {largest:g} cd; "
            f"expected at least 0 (down to {-_NOISE * largest:g} would count as noise)"
        )
    return np.maximum(intensity, 0), least


def _check_half_space(
    kind: str, horizontal: Array, vertical: Array, limits: tuple[int, int]
) -> None:
    """Refuse angles H and V of Type A or B that are beyond their limits, or one alone.

    LM-63 has a symmetry about an axis, with one horizontal angle, for Type C alone.
    """
    _check_ascending(horizontal, vertical)
    inside = all(
        len(angles) > 1 and -limit <= angles[0] and angles[-1] <= limit
        for angles, limit in zip((horizontal, vertical), limits, strict=True)
    )
    if not inside:
        raise LumitreeError(
            f"its horizontal angles are {_range(horizontal)}, its vertical angles "
            f"{_range(vertical)}; expected several of each in photometry of Type {kind}, within "
            f"-{limits[0]} to {limits[0]} and -{limits[1]} to {limits[1]}"
        )


def _mirrored(angles: Array, rows: Array) -> tuple[Array, Array]:
    return np.concatenate([-angles[:0:-1], angles]), np.concatenate([rows[:0:-1], rows])


def _reflected(c: Array, rows: Array, plane: float) -> tuple[Array, Array]:
    """Planes and those that are symmetric to them, ascending."""
    both, first = np.unique(np.append(c, 2 * plane - c), return_index=True)
    return both, np.concatenate([rows, rows])[first]


def _with_edges(angles: Array, intensity: Array, low: float, high: float) -> tuple[Array, Array]:
    """Angles [N] from `low` to `high` and intensities [M, N], which are 0 outside those given."""
    if angles[0] > low:
        edge = angles[0] - min(EDGE, (angles[0] - low) / 2)
        angles = np.concatenate([[low, edge], angles])
        intensity = np.pad(intensity, ((0, 0), (2, 0)))
    if angles[-1] < high:
        edge = angles[-1] + min(EDGE, (high - angles[-1]) / 2)
        angles = np.concatenate([angles, [edge, high]])
        intensity = np.pad(intensity, ((0, 0), (0, 2)))
    return angles, intensity


def _check_ascending(planes: Array, angles: Array) -> None:
    if not ((np.diff(planes) > 0).all() and (np.diff(angles) > 0).all()):
        raise LumitreeError("its angles are not ascending")
    if len(planes) < 1 or len(angles) < 2:
        raise LumitreeError(
            f"it has {len(planes)} planes of {len(angles)} angles; expected at least 1 of 2"
        )


def _range(angles: Array) -> str:
    return f"{angles[0]:g} to {angles[-1]:g}" if len(angles) > 1 else f"{angles[0]:g}"
