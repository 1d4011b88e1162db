"""Directions of Type C photometry, and intensities at the nodes of a grid of them.

Symbols
    γ       angle from straight down: 0° down, 90° horizontal, 180° up
    C       angle about the vertical axis: 0° towards +x, counter-clockwise seen from above
    node    a pair (C, γ) of a grid; between nodes, intensity is interpolated bilinearly in C and γ
    hat     the bilinear weight of a node: 1 there, 0 at its neighbours

The frame is the luminaire file's: y is up, so a direction is
(sin γ cos C, -cos γ, -sin γ sin C).
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
        return self._per_solid_angle(self._accumulate(direction, flux, 1))

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

    def _per_solid_angle(self, flux: NDArray[np.float64]) -> NDArray[np.float64]:
        angles = node_solid_angles(self.c, self.gamma)
        intensity = flux / angles
        for pole in (0, -1):
            intensity[:, pole] = flux[:, pole].sum() / angles[:, pole].sum()
        return intensity


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
        generation: file generation type of LM-63-2019, see `ies_fields`; None if it is not stated.
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
    generation: str | None = None
    details: Mapping[str, str] = dataclasses.field(default_factory=dict)
    turned: "Turned | None" = None

    def __post_init__(self) -> None:
        """Refuse what cannot be interpolated, and numbers that are not finite."""
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
            raise LumitreeError("intensities hold NaN, negative values or values above 1e12 cd")
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
