"""Type C photometry: directions, intensities at the nodes of a grid, and the other types as it.

Symbols
    γ       angle from straight down: 0° down, 90° horizontal, 180° up
    C       angle about the vertical axis: 0° towards +x, counter-clockwise seen from above
    node    a pair (C, γ) of a grid; between nodes, intensity is interpolated bilinearly in C and γ
    hat     the bilinear weight of a node: 1 there, 0 at its neighbours

The frame is the luminaire file's: y is up, so a direction is
(sin γ cos C, -cos γ, -sin γ sin C).

Photometry of the other types is measured in the photometric half-space only, by horizontal angles H
and vertical angles V from -90 to 90 degrees:

    A   the polar axis is vertical, H is the longitude about it and V the latitude. H = V = 0 is
        horizontal, towards C = 0, and V = 90 is up. So γ = 90 + V, and C = -H, since H is counted
        clockwise seen from above
    B   the polar axis is horizontal, from C = 90 to C = 270; V is the longitude about it, and H the
        latitude. H = V = 0 is down, V = 90 is towards C = 0, and H = 90 towards C = 270. V and -H
        are the angles B and β of CIE 121

Sources: section 3 of ANSI/IESNA LM-63-02, by which H = V = 0 is photometric zero, straight down, in
Type B and photometric horizontal in Type A, and H is clockwise in both; Ashdown (1998), by whom the
polar axis of Type B is along the width of the opening; and the frames of the glTF extension
EXT_lights_ies, in the notation of IES LM-75.
"""

import dataclasses
from collections.abc import Mapping

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.errors import LumitreeError, shown
from lumitree.formats.opening import POINT, Opening

Array = NDArray[np.float64]
# Finest and coarsest step of a grid, degrees.
MIN_STEP, MAX_STEP = 0.5, 30.0
# Least difference of neighbouring angles, degrees: weights of nodes are divided by it.
_LEAST_STEP = 1e-10
_MAX_LUMENS = 1e15
# A step at the edge of the given angles, degrees: the light ends there.
EDGE = 1e-3
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


def direction_of(c: ArrayLike, gamma: ArrayLike) -> Array:
    """Unit direction [..., 3] of the angles C and γ [...], degrees."""
    c, gamma = np.deg2rad(c), np.deg2rad(gamma)
    return np.stack(
        np.broadcast_arrays(np.sin(gamma) * np.cos(c), -np.cos(gamma), -np.sin(gamma) * np.sin(c)),
        axis=-1,
    )


def angles_of(direction: ArrayLike) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Angles C, 0 to 360, and γ, 0 to 180 [...], degrees, of directions [..., 3] of any length."""
    x, y, z = np.moveaxis(np.asarray(direction, np.float64), -1, 0)
    gamma = np.rad2deg(np.arctan2(np.hypot(x, z), -y))
    # The remainder of a tiny negative angle is 360.
    return np.rad2deg(np.arctan2(-z, x)) % 360.0 % 360.0, gamma


def z_up(vectors: ArrayLike) -> Array:
    """Array [..., 3] of a frame with y up in a frame with z up, as ray files have it."""
    x, y, z = np.moveaxis(np.asarray(vectors, np.float64), -1, 0)
    return np.stack([x, -z, y], axis=-1)


def y_up(vectors: ArrayLike) -> Array:
    """Inverse of `z_up`."""
    x, y, z = np.moveaxis(np.asarray(vectors, np.float64), -1, 0)
    return np.stack([x, z, -y], axis=-1)


def node_solid_angles(c: ArrayLike, gamma: ArrayLike) -> NDArray[np.float64]:
    """Integrals [C, G] of the hats over the sphere, sr.

    The sum of intensity times these is the flux of the interpolated intensity.

    Args:
        c: [C] ascending angles from 0 to below 360, degrees; the last is followed by the first.
        gamma: [G] ascending angles from 0 to 180, degrees.
    """
    c, gamma = np.deg2rad(np.asarray(c, np.float64)), np.deg2rad(np.asarray(gamma, np.float64))
    gaps = np.diff(c, append=c[0] + 2 * np.pi)
    widths = (gaps + np.roll(gaps, 1)) / 2
    # Integral of each half of a hat times sin γ, in closed form.
    slope = np.diff(np.sin(gamma)) / np.diff(gamma)
    falling, rising = np.cos(gamma[:-1]) - slope, slope - np.cos(gamma[1:])
    heights = np.zeros(len(gamma))
    heights[:-1] += falling
    heights[1:] += rising
    return widths[:, None] * heights


@dataclasses.dataclass(frozen=True)
class Grid:
    """Grid of nodes with one step in C and γ.

    Attributes:
        step: degrees, 0.5 to 30; 90 is a multiple of it.
    """

    step: float

    def __post_init__(self) -> None:
        """Refuse steps that do not divide a right angle."""
        number = isinstance(self.step, int | float)
        parts = 90 / self.step if number and MIN_STEP <= self.step <= MAX_STEP else 0.5
        if abs(parts - round(parts)) > 1e-9:
            raise LumitreeError(
                f"angular step is {self.step}; expected {MIN_STEP} to {MAX_STEP:g} degrees that "
                "divide 90, such as 1, 2.5, 5 or 10"
            )

    @property
    def c(self) -> NDArray[np.float64]:
        """[C] angles of the half-planes, from 0 to below 360 degrees."""
        return self.step * np.arange(round(360 / self.step), dtype=np.float64)

    @property
    def gamma(self) -> NDArray[np.float64]:
        """[G] angles from 0 to 180 degrees."""
        return self.step * np.arange(round(180 / self.step) + 1, dtype=np.float64)

    def intensity(self, direction: Array, flux: NDArray[np.float64]) -> NDArray[np.float64]:
        """Intensity [C, G] of rays: mean over each node's hat, flux per steradian.

        The flux of a ray is divided between the four nodes around it by their hats. So the
        interpolated intensity has the flux of the rays. At γ = 0 and 180 all C are one node.

        Args:
            direction: [N, 3] directions of travel.
            flux: [N] of each ray.
        """
        sums, angles = self._accumulate(direction, flux, 1), node_solid_angles(self.c, self.gamma)
        intensity = sums / angles
        for pole in (0, -1):
            intensity[:, pole] = sums[:, pole].sum() / angles[:, pole].sum()
        return intensity

    def variance(self, direction: Array, flux: NDArray[np.float64]) -> NDArray[np.float64]:
        """Variance [C, G] of `intensity` for independent rays, of which there are many."""
        sums = self._accumulate(direction, flux, 2)
        angles = node_solid_angles(self.c, self.gamma)
        gamma = angles_of(direction)[1]
        # Each pole is one node.
        for pole, away in ((0, gamma), (-1, 180 - gamma)):
            weight = np.maximum(1 - away / self.step, 0)
            sums[:, pole], angles[:, pole] = ((weight * flux) ** 2).sum(), angles[:, pole].sum()
        return sums / angles**2

    def _accumulate(
        self, direction: Array, flux: NDArray[np.float64], power: int
    ) -> NDArray[np.float64]:
        """Sums [C, G] of (weight · flux)^power over the rays."""
        planes, rows = len(self.c), len(self.gamma)
        total = np.zeros(planes * rows)
        c, gamma = (angle / self.step for angle in angles_of(direction))
        plane = np.minimum(c.astype(np.int64), planes - 1)
        row = np.minimum(gamma.astype(np.int64), rows - 2)
        u, v = c - plane, gamma - row
        for next_plane, along in ((0, 1 - u), (1, u)):
            for next_row, across in ((0, 1 - v), (1, v)):
                node = (plane + next_plane) % planes * rows + row + next_row
                weight = (along * across * flux) ** power
                total += np.bincount(node, weight, len(total))
        return total.reshape(planes, rows)


@dataclasses.dataclass(frozen=True, eq=False)
class IntensityDistribution:
    """Luminous intensity at the nodes of a grid, as photometric files hold it.

    Attributes:
        name: of the luminaire.
        c: [C] ascending angles from 0 to below 360, degrees.
        gamma: [G] ascending angles from 0 to 180, degrees.
        intensity: [C, G] luminous intensity, cd, at least 0.
        opening: the surface that the light comes from.
        emitted_lumens: luminous flux of the bare emitters, 0 to 1e15 lm; None if it is not known.
        watts: electrical power, above 0 to 1e9 W; None if it is not known.
        generation: file generation type of LM-63-2019, see `ies`; None if it is not stated.
        details: what its file states of how it was made, for reports: names and texts.
        turned: the same intensities in angles about another axis, as a file of Type B states them;
            `at` then returns these. None if the file has C and γ.
    """

    name: str
    c: NDArray[np.float64]
    gamma: NDArray[np.float64]
    intensity: NDArray[np.float64]
    opening: Opening = POINT
    emitted_lumens: float | None = None
    watts: float | None = None
    generation: str | None = None
    details: Mapping[str, str] = dataclasses.field(default_factory=dict)
    turned: "Turned | None" = None

    def __post_init__(self) -> None:
        """Refuse tables that cannot be interpolated, and numbers that are not finite."""
        c, gamma, intensity = self.c, self.gamma, self.intensity
        if intensity.shape != (len(c), len(gamma)) or len(gamma) < 2 or len(c) < 1:
            raise LumitreeError(
                f"{intensity.shape} intensities for {len(c)} C and {len(gamma)} gamma angles"
            )
        ascend = all((np.diff(angles) >= _LEAST_STEP).all() for angles in (gamma, c))
        if not (ascend and gamma[0] == 0 and gamma[-1] == 180 and c[0] >= 0 and c[-1] < 360):
            raise LumitreeError(
                f"the angles are not ascending by {_LEAST_STEP:g} degrees or more, C from 0 to "
                "below 360 and gamma from 0 to 180"
            )
        # Limits within which all further computations are finite in single precision.
        if not ((intensity >= 0) & (intensity <= 1e12)).all():
            raise LumitreeError("there are intensities that are NaN, negative or above 1e12 cd")
        # All writers get their numbers from here: none writes one that is not finite.
        if not 0 <= (emitted := self.emitted_lumens or 0.0) <= _MAX_LUMENS:
            raise LumitreeError(
                f"the flux of the bare emitters of {shown(self.name, 200)} is {emitted:g} lm; "
                f"expected 0 to {_MAX_LUMENS:g}"
            )

    @property
    def lumens(self) -> float:
        """Luminous flux of the interpolated intensity, lm."""
        return float((self.intensity * node_solid_angles(self.c, self.gamma)).sum())

    def at(self, direction: ArrayLike) -> NDArray[np.float64]:
        """Intensity [...], cd, interpolated for directions [..., 3] of any length."""
        if self.turned is not None:
            return self.turned.at(direction)
        c, gamma = angles_of(direction)
        planes = np.append(self.c, self.c[0] + 360)
        # Angles before the first plane follow the last.
        c = np.where(c < planes[0], c + 360, c)
        plane = np.clip(np.searchsorted(planes, c, "right") - 1, 0, len(self.c) - 1)
        row = np.clip(np.searchsorted(self.gamma, gamma, "right") - 1, 0, len(self.gamma) - 2)
        u = (c - planes[plane]) / (planes[plane + 1] - planes[plane])
        v = (gamma - self.gamma[row]) / (self.gamma[row + 1] - self.gamma[row])
        following = (plane + 1) % len(self.c)
        lower = (1 - u) * self.intensity[plane, row] + u * self.intensity[following, row]
        upper = (1 - u) * self.intensity[plane, row + 1] + u * self.intensity[following, row + 1]
        return (1 - v) * lower + v * upper


@dataclasses.dataclass(frozen=True, eq=False)
class Turned:
    """Intensities in angles about another axis than the vertical.

    Attributes:
        distribution: intensities in C and γ of the other frame.
        rotation: [3, 3] of directions into that frame.
    """

    distribution: IntensityDistribution
    rotation: NDArray[np.float64]

    def at(self, direction: ArrayLike) -> NDArray[np.float64]:
        """Intensity [...], cd, for directions [..., 3] of the frame of `type_c`."""
        return self.distribution.at(np.asarray(direction, np.float64) @ self.rotation.T)


def completed(c: Array, gamma: Array, intensity: Array) -> tuple[Array, Array, Array]:
    """Angles and intensities [C, G] of the whole sphere from the planes of a Type C file.

    One plane stands for rotational symmetry. Planes over a quarter or a half of the circle stand
    for symmetry about one or both of the planes C = 0 and C = 90. Where a file has no γ, it is
    dark. Angles are ascending, in degrees, γ within 0 to 180.
    """
    _check_ascending(c, gamma)
    if not 0 <= gamma[0] <= gamma[-1] <= 180:
        raise LumitreeError(f"its gamma angles are {_range(gamma)}; expected them within 0 to 180")
    for plane in _SYMMETRIES.get((float(c[0]), float(c[-1])), ()):
        # The planes and their mirror images, ascending.
        c, first = np.unique(np.append(c, 2 * plane - c), return_index=True)
        intensity = np.concatenate([intensity, intensity])[first]
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


def _check_half_space(
    kind: str, horizontal: Array, vertical: Array, limits: tuple[int, int]
) -> None:
    """Refuse angles H and V of Type A or B that are beyond their limits, or a single angle.

    In LM-63 only Type C has a symmetry about an axis, with one horizontal angle.
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


def _with_edges(angles: Array, intensity: Array, low: float, high: float) -> tuple[Array, Array]:
    """Angles [N] from `low` to `high` and intensities [M, N], which are 0 beyond them."""
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
