"""Photometric figures of a measurement, with standard errors."""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lumitree.formats.opening import Opening
from lumitree.formats.type_c import Grid, IntensityDistribution
from lumitree.measure.photometry.colour import ColourFigures
from lumitree.measure.photometry.near_field import NearFieldLimit

# Parts of the largest intensity of a plane at which the beam and the field end.
BEAM, FIELD = 0.5, 0.1
# The planes in which beam and field are measured: C of one half; the other is opposite.
PLANES = {"C0-C180": 0.0, "C90-C270": 90.0}


@dataclasses.dataclass(frozen=True)
class Estimate:
    """An estimate.

    Attributes:
        value: the estimate.
        error: its standard error.
    """

    value: float
    error: float

    def __str__(self) -> str:
        """Value ± standard error, rounded to two significant digits of the error."""
        # Of rounding alone there may be a tiny error.
        if not (math.isfinite(self.error) and self.error > 1e-9 * abs(self.value)):
            return f"{float(f'{self.value:.5g}'):,.12g}"
        digits = 1 - math.floor(math.log10(self.error))
        value, error = round(self.value, digits), round(self.error, digits)
        shown = max(0, digits)
        return f"{value:,.{shown}f} ± {error:,.{shown}f}"


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhotometricFigures:
    """Photometric figures of a luminaire or an asset.

    Angles are those of Type C photometry: gamma from straight down, C about the vertical axis from
    +x, counter-clockwise seen from above.

    Attributes:
        lumens: luminous flux, lm.
        emitted_lumens: luminous flux of the bare emitters, lm; of a photometric file that of the
            lamps that it states. None for an asset, and for absolute photometry.
        light_output_ratio: `lumens` over `emitted_lumens`; None if that is.
        upward_share: part of the luminous flux above the horizontal, 0 to 1; the rest goes down.
        max_candela: largest luminous intensity, cd: that of the direction in which the intensity
            less two standard errors is largest.
        max_c, max_gamma: angles of `max_candela`, degrees.
        beam_angles: by plane, "C0-C180" and "C90-C270": angle around the plane's largest intensity
            in which the intensity is at least half of it, degrees; 360 if it is so everywhere.
        field_angles: the same for a tenth.
        colour_temperature: correlated colour temperature of the mean colour of the light that
            leaves, by its RGB, K; None if it is not defined for this colour,
            or if a photometric file states none.
        duv: distance of this colour from the Planckian locus, CIE 1960 (u, v); positive above.
        spectrum_share: part of the luminous flux of the bare emitters whose spectrum is known.
        emitted_colour: colour of the bare emitters by their spectrum; None if it is not known.
        opening: luminous opening: of a photometric file its own, else the smallest box or ellipsoid
            from which 98 % of the light leaves.
        opening_centre: [3] of the opening, which is the photometric centre, from the centre of the
            bounding box, m; y is up.
    """

    lumens: Estimate
    emitted_lumens: Estimate | None
    light_output_ratio: Estimate | None
    upward_share: Estimate
    max_candela: Estimate
    max_c: float
    max_gamma: float
    beam_angles: dict[str, Estimate]
    field_angles: dict[str, Estimate]
    colour_temperature: Estimate | None
    duv: Estimate | None
    spectrum_share: float
    emitted_colour: ColourFigures | None
    opening: Opening
    opening_centre: tuple[float, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class PhotometricData:
    """All that a report shows.

    Attributes:
        figures: the figures.
        distribution: the intensities.
        intensity_error: [C, G] standard errors of the intensities, cd.
        near_field: result of the inverse-square test, by direction.
        step: of the angles, degrees.
        size: [3] sides of the bounding box, m.
        num_rays: light paths, or rays of an asset.
        ugr: table of glare ratings, see `ugr_table`; None without the package for it.
    """

    figures: PhotometricFigures
    distribution: IntensityDistribution
    intensity_error: NDArray[np.float64]
    near_field: list[NearFieldLimit]
    step: float
    size: NDArray[np.float64]
    num_rays: int
    ugr: NDArray[np.float64] | None


def width_at(intensity: NDArray[np.float64], step: float, part: float) -> float:
    """Angle, degrees, around the largest value of a closed curve in which it is at least a part.

    Args:
        intensity: [N] intensity by angle, in equal steps around a full turn.
        step: between the angles, degrees.
        part: of the largest value; the curve between the angles is linear.
    """
    curve = np.roll(intensity, -int(intensity.argmax())) / max(float(intensity.max()), 1e-300)
    if curve.min() >= part:
        return 360.0
    if not curve.any():
        return 0.0
    return step * sum(
        float(first + (side[first] - part) / (side[first] - side[first + 1]))
        for side in (curve, np.roll(curve[::-1], 1))
        for first in (int((side < part).argmax()) - 1,)
    )


def plane_curve(grid: Grid, intensity: NDArray[np.float64], c: float) -> NDArray[np.float64]:
    """Intensity around a vertical plane from straight down: up on the side of `c`, and back.

    `c` is a multiple of the step, in degrees; the intensity is [C, G].
    """
    planes = len(grid.c)
    first = round(c / grid.step) % planes
    half, opposite = intensity[first], intensity[(first + planes // 2) % planes]
    return np.concatenate([half, opposite[-2:0:-1]])
