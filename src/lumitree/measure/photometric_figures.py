"""Photometric figures of a measurement, with standard errors, and their tables as text.

Colour rendering needs a spectrum: CRI is the general and a special colour rendering index of CIE
13.3-1995, TM-30 the fidelity and the gamut index of ANSI/IES TM-30-18, both by the optional package
`colour-science`.

The Unified Glare Rating of CIE 117:1995 and CIE 190:2010, of a room with a regular ceiling of equal
luminaires, is

    UGR = 8 log₁₀(0.25 / L_b · Σ L² ω / p²)

with the luminance L of each luminaire towards an observer, cd/m², the solid angle ω of its luminous
area, its position index p by Guth, and the luminance L_b of the background. The optional package
`eulumdat-ugr` has the tables of CIE 117 and CIE 190.
"""

import dataclasses
import math
import warnings
from collections.abc import Callable, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import EmittedSpectrum
from lumitree.core.photometry import (
    WAVELENGTHS,
    chromaticity_difference,
    colour_temperature,
    luminance,
    xyz_from_srgb,
    xyz_of_spectrum,
    xyz_temperature,
)
from lumitree.core.results import digits_text
from lumitree.formats.ies import SIMULATED
from lumitree.formats.ldt import ldt_of
from lumitree.formats.opening import Opening
from lumitree.formats.type_c import Grid, IntensityDistribution, direction_of
from lumitree.measure.batches import jackknife
from lumitree.measure.near_field import NearFieldLimit

if TYPE_CHECKING:
    from lumitree.measure.far_field import Measurement

Mask = NDArray[np.bool_]
# Parts of the largest intensity of a plane at which the beam and the field end.
BEAM, FIELD = 0.5, 0.1
# The planes in which beam and field are measured: C of one half; the other is opposite.
PLANES = {"C0-C180": 0.0, "C90-C270": 90.0}
# Angles γ and C of the luminances that limits of glare are stated for, degrees.
GLARE_ANGLES, _HALF_PLANES = (65, 75, 85), (0, 90, 180, 270)
# Standard errors by which the largest intensity must exceed other nodes'.
_CERTAIN = 2
# Sides of the rooms of the UGR table across and along the line of sight, in mounting heights above
# the eye.
ROOMS = (
    *((2, y) for y in (2, 3, 4, 6, 8, 12)),
    *((4, y) for y in (2, 3, 4, 6, 8, 12)),
    *((8, y) for y in (4, 6, 8, 12)),
    *((12, y) for y in (4, 6, 8)),
)
# Reflectances of ceiling, walls and floor, percent.
REFLECTANCES = ("70/50/20", "70/30/20", "50/50/20", "50/30/20", "30/30/20")
# Catalogues state one rating: of the room 4H x 8H, for the first reflectances.
CATALOGUE_ROOM = ROOMS.index((4, 8))
NEAR_FIELD_HEADER = ("direction", "intensity in 5°", "far field from", "difference at 5 x the size")
UGR_HEADER = ("room", *REFLECTANCES, *REFLECTANCES)
_NEEDS_UGR = "needs the package eulumdat-ugr: pip install 'lumitree[ugr]'"
_NEEDS_COLOUR = "needs the package colour-science: pip install 'lumitree[colour]'"


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
        """Value ± standard error, rounded to two significant digits of the error.

        Without the error where it is not known, or four digits of the value do not show it.
        """
        if not (math.isfinite(self.error) and self.error > 5e-5 * abs(self.value)):
            return digits_text(self.value)
        digits = 1 - math.floor(math.log10(self.error))
        value, error = round(self.value, digits), round(self.error, digits)
        shown = max(0, digits)
        return f"{value:,.{shown}f} ± {error:,.{shown}f}"

    @property
    def percent(self) -> "Estimate":
        """A fraction in percent."""
        return Estimate(100 * self.value, 100 * self.error)


@dataclasses.dataclass(frozen=True, kw_only=True)
class RenderingIndices:
    """Figures of colour rendering of a spectrum.

    Attributes:
        ra: general colour rendering index Ra, at most 100.
        r9: special index R9, of a saturated red.
        rf: fidelity index Rf, 0 to 100.
        rg: gamut index Rg, about 60 to 140; 100 for the reference.
    """

    ra: float
    r9: float
    rf: float
    rg: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class ColourFigures:
    """Colour of the light of a luminaire's bare emitters, by their spectrum.

    Attributes:
        colour_temperature: correlated colour temperature, K; None if it is not defined.
        duv: distance from the Planckian locus, CIE 1960 (u, v); positive above.
        rendering: figures of colour rendering; None without a colour temperature, or without the
            package `colour-science`.
        shift: distance in the CIE 1976 (u', v') diagram between the mean RGB colour of the light
            that leaves the luminaire and the colour of the spectrum. Glass, surfaces and a
            `temperature` of the bake cause it, and for saturated colours the gamut of sRGB.
    """

    colour_temperature: float | None
    duv: float
    rendering: RenderingIndices | None
    shift: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhotometricFigures:
    """Photometric figures of a luminaire or an asset.

    Angles are Type C photometry: gamma from straight down, C about the vertical axis from +x,
    counter-clockwise seen from above.

    Attributes:
        lumens: luminous flux, lm.
        emitted_lumens: luminous flux of the bare emitters, lm; the flux of the lamps that a
            photometric file states. None for an asset, and for absolute photometry.
        watts: electrical power that a photometric file states, W; None if it does not.
        efficacy: `lumens` over `watts`, lm/W; None without a power.
        light_output_ratio: `lumens` over `emitted_lumens`; None if that is.
        upward_share: part of the luminous flux above the horizontal, 0 to 1; the rest goes down.
        max_candela: largest luminous intensity, cd: in the direction in which the intensity less
            two standard errors is largest.
        max_c, max_gamma: angles of `max_candela`, degrees.
        beam_angles: by plane, "C0-C180" and "C90-C270": angle around the plane's largest intensity
            in which the intensity is at least half of it, degrees; 360 if it is so everywhere.
        field_angles: the same for a tenth.
        luminance: by half-plane, "C0" to "C270": intensity at γ = 65, 75 and 85 degrees over the
            area of the opening seen from there, cd/m²; without the half-planes in which there is
            no such area.
        colour_temperature: correlated colour temperature of the mean colour of the light that
            leaves, by its RGB, K; None if it is not defined for this colour,
            or if a photometric file states none.
        duv: distance of this colour from the Planckian locus, CIE 1960 (u, v); positive above.
        spectrum_share: part of the luminous flux of the bare emitters whose spectrum is known.
        emitted_colour: colour of the bare emitters by their spectrum; None if it is not known.
        opening: luminous opening: a photometric file states its own; else the smallest box or
            ellipsoid from which 98 % of the light leaves.
        opening_centre: [3] of the opening, which is the photometric centre, from the centre of the
            bounding box, m; y is up.
    """

    lumens: Estimate
    emitted_lumens: Estimate | None
    light_output_ratio: Estimate | None
    watts: float | None
    efficacy: Estimate | None
    upward_share: Estimate
    max_candela: Estimate
    max_c: float
    max_gamma: float
    beam_angles: dict[str, Estimate]
    field_angles: dict[str, Estimate]
    luminance: dict[str, list[Estimate]]
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
        near_field: result of the inverse-square test, by direction; empty without rays.
        step: of the angles, degrees.
        size: [3] sides of the bounding box, m.
        num_rays: light paths, or rays of an asset; 0 for a photometric file.
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


def evaluated(
    measurement: "Measurement",
    file: IntensityDistribution | None = None,
    generation: str = SIMULATED,
    *,
    of_file: bool = False,
) -> PhotometricData:
    """Figures, intensities and near-field limits of a measurement.

    Args:
        measurement: of a luminaire or an asset.
        file: the photometric file that the asset was made of: the flux of its lamps and what it
            states of how it was made.
        generation: file generation type of written files.
        of_file: whether the light is described by a photometric file, also by one that was baked: a
            file that states no colour has equal R, G and B.
    """
    grid, watts, emitted = measurement.grid, measurement.watts, measurement.emitted

    def lumens(used: Mask) -> float:
        return float(luminance(watts[used].mean(axis=0)))

    def colour(used: Mask) -> NDArray[np.float64]:
        return np.array(colour_temperature(watts[used].mean(axis=0)))

    def width(used: Mask, c: float, part: float) -> float:
        intensity = measurement.intensity[used].mean(axis=0)
        return width_at(plane_curve(grid, intensity, c), grid.step, part)

    emitted_lumens = ratio = None
    if emitted is not None:

        def bare(used: Mask) -> float:
            return float(luminance(emitted[used].mean(axis=0)))

        emitted_lumens = _estimate(bare)
        # Some batches may have found no light.
        ratio = _estimate(lambda used: lumens(used) / (bare(used) or math.inf))
    elif file is not None and (lamps := file.emitted_lumens) is not None:
        emitted_lumens = Estimate(lamps, 0.0)
        ratio = _estimate(lambda used: lumens(used) / lamps)
    intensity, error = jackknife(lambda used: measurement.intensity[used].mean(axis=0))
    # Where it is large with certainty: rare paths of large flux make single nodes uncertain.
    certain = intensity - _CERTAIN * error
    plane, row = np.unravel_index(certain.argmax(), certain.shape)
    (kelvin, duv), (kelvin_error, duv_error) = (each.tolist() for each in jackknife(colour))
    mean = watts.mean(axis=0)
    coloured = not (of_file and np.allclose(mean, mean[0], rtol=1e-6, atol=0))
    angles = {
        part: {
            name: _estimate(lambda used, c=c, part=part: width(used, c, part))
            for name, c in PLANES.items()
        }
        for part in (BEAM, FIELD)
    }
    opening, power = measurement.opening, None if file is None else file.watts

    areas = {f"C{c}": opening.projected_area(direction_of(c, GLARE_ANGLES)) for c in _HALF_PLANES}

    def luminances(half_plane: str) -> list[Estimate]:
        row = round(int(half_plane[1:]) / grid.step)
        values, errors = (
            np.interp(GLARE_ANGLES, grid.gamma, each[row]) / areas[half_plane]
            for each in (intensity, error)
        )
        return list(map(Estimate, values.tolist(), errors.tolist()))

    figures = PhotometricFigures(
        lumens=_estimate(lumens),
        watts=power,
        efficacy=None if power is None else _estimate(lambda used: lumens(used) / power),
        emitted_lumens=emitted_lumens,
        light_output_ratio=ratio,
        upward_share=_estimate(lambda used: measurement.upward[used].mean() / lumens(used)),
        max_candela=Estimate(float(intensity[plane, row]), float(error[plane, row])),
        max_c=float(grid.c[plane]),
        max_gamma=float(grid.gamma[row]),
        beam_angles=angles[BEAM],
        field_angles=angles[FIELD],
        luminance={name: luminances(name) for name, area in areas.items() if area.all()},
        colour_temperature=Estimate(kelvin, kelvin_error)
        if coloured and math.isfinite(kelvin_error)
        else None,
        duv=Estimate(duv, duv_error) if coloured and math.isfinite(duv_error) else None,
        spectrum_share=0.0 if measurement.spectrum is None else measurement.spectrum.share,
        emitted_colour=colour_figures(measurement.spectrum, mean),
        opening=measurement.opening,
        opening_centre=tuple(measurement.centre.tolist()),
    )
    distribution = IntensityDistribution(
        name=measurement.name,
        c=grid.c,
        gamma=grid.gamma,
        intensity=intensity,
        opening=measurement.opening,
        emitted_lumens=None if emitted_lumens is None else emitted_lumens.value,
        watts=power,
        generation=generation,
        details={} if file is None else file.details,
    )
    return PhotometricData(
        figures=figures,
        distribution=distribution,
        intensity_error=error,
        near_field=[] if measurement.near_field is None else measurement.near_field.limits(),
        step=grid.step,
        size=measurement.size,
        num_rays=measurement.num_rays,
        ugr=ugr_table(distribution),
    )


def _estimate(figure: Callable[[Mask], float]) -> Estimate:
    value, error = jackknife(figure)
    return Estimate(float(value), float(error))


def half_widths(intensity: NDArray[np.float64], step: float, part: float) -> tuple[float, float]:
    """Angles, degrees, on both sides of the start of a closed curve at which it falls to a part.

    Args:
        intensity: [N] intensity by angle, in equal steps around a full turn.
        step: between the angles, degrees.
        part: of the first value; the curve between the angles is linear. A curve that does not
            fall so far has 180 degrees.
    """
    curve = intensity / max(float(intensity[0]), 1e-300)
    if curve.min() >= part:
        return 180.0, 180.0
    forth, back = (
        step * float(first + (side[first] - part) / (side[first] - side[first + 1]))
        for side in (curve, np.roll(curve[::-1], 1))
        for first in (int((side < part).argmax()) - 1,)
    )
    return forth, back


def width_at(intensity: NDArray[np.float64], step: float, part: float) -> float:
    """Angle, degrees, around the largest value of a closed curve; arguments as `half_widths`."""
    peak = np.roll(intensity, -int(intensity.argmax()))
    return sum(half_widths(peak, step, part)) if peak.any() else 0.0


def plane_curve(grid: Grid, intensity: NDArray[np.float64], c: float) -> NDArray[np.float64]:
    """Intensity around a vertical plane from straight down: up on the side of `c`, and back.

    `c` is a multiple of the step, in degrees; the intensity is [C, G].
    """
    planes = len(grid.c)
    first = round(c / grid.step) % planes
    half, opposite = intensity[first], intensity[(first + planes // 2) % planes]
    return np.concatenate([half, opposite[-2:0:-1]])


def colour_figures(
    spectrum: EmittedSpectrum | None, watts: NDArray[np.float64]
) -> ColourFigures | None:
    """The colour of a luminaire's emitters by their spectrum.

    Args:
        watts: [3] radiant flux of R, G and B that leaves it; only the ratios matter.

    Returns:
        The figures; None if the spectrum of more than 0.1 % of the luminous flux is not known.
    """
    if spectrum is None or not spectrum.is_whole:
        return None
    power = spectrum.power.astype(np.float64)
    xyz = xyz_of_spectrum(power)
    temperature, duv = xyz_temperature(xyz)
    known = math.isfinite(temperature)
    return ColourFigures(
        colour_temperature=temperature if known else None,
        duv=duv,
        rendering=rendering_indices(power) if known else None,
        shift=chromaticity_difference(xyz, xyz_from_srgb(watts)),
    )


def rendering_indices(spectrum: NDArray[np.float64]) -> RenderingIndices | None:
    """Figures of colour rendering of a spectrum.

    Args:
        spectrum: [471] power per nm at `WAVELENGTHS`, relative.

    Returns:
        The figures; None if the package `colour-science` is not installed.
    """
    with warnings.catch_warnings():
        # The package warns of parts that are not used here, and of interpolation.
        warnings.simplefilter("ignore")
        try:
            from colour import SpectralDistribution, colour_rendering_index
            from colour.quality import colour_fidelity_index_ANSIIESTM3018
        except ImportError:
            return None
        power = SpectralDistribution(dict(zip(WAVELENGTHS.tolist(), spectrum, strict=True)))
        cri = colour_rendering_index(power, additional_data=True)
        tm30 = colour_fidelity_index_ANSIIESTM3018(power, additional_data=True)
    return RenderingIndices(
        ra=float(cri.Q_a), r9=float(cri.Q_as[9].Q_a), rf=float(tm30.R_f), rg=float(tm30.R_g)
    )


def ugr_table(distribution: IntensityDistribution) -> NDArray[np.float64] | None:
    """The table of Unified Glare Ratings.

    Luminaires are a quarter of the mounting height of 2 m apart. Only intensities from C0 to C90
    are used, as if the luminaire were symmetrical. Its luminous area is its opening's.

    Returns:
        [19, 10] ratings by `ROOMS`, and by `REFLECTANCES` for lamps seen crosswise (their C0 plane
        is along the line of sight) and then endwise. NaN where no light comes from below 85
        degrees. None if the package `eulumdat-ugr` is not installed.
    """
    try:
        from eulumdat_ugr import UgrCalculator
    except ImportError:
        return None
    # Without a flux of bare emitters the file would state absolute photometry by a number of -1.
    known = dataclasses.replace(
        distribution, emitted_lumens=distribution.emitted_lumens or distribution.lumens
    )
    if not (known.lumens > 0 and max(known.opening.sides) > 0):
        return np.full((len(ROOMS), 2 * len(REFLECTANCES)), np.nan)
    with np.errstate(all="ignore"):
        return np.asarray(UgrCalculator.compute(ldt_of(known)).values, np.float64)


def figure_rows(
    figures: PhotometricFigures,
    size: Sequence[float],
    step: float,
    rays: int,
    ugr: NDArray[np.float64] | None,
) -> list[tuple[str, str]]:
    """Names and values of the figures; `size` to `ugr` as of `PhotometricData`."""
    up = figures.upward_share
    rows = [("luminous flux", f"{figures.lumens} lm")]
    if figures.emitted_lumens is not None and figures.light_output_ratio is not None:
        rows += [
            ("flux of the bare emitters", f"{figures.emitted_lumens} lm"),
            ("light output ratio", f"{figures.light_output_ratio.percent} %"),
        ]
    if figures.watts is None:
        rows.append(("power", "not known: no watts are stated"))
    else:
        rows += [("power", f"{figures.watts:g} W"), ("efficacy", f"{figures.efficacy} lm/W")]
    rows += [
        (
            "largest intensity",
            f"{figures.max_candela} cd at C = {figures.max_c:g}°, gamma = {figures.max_gamma:g}°",
        ),
        ("upward share of the flux", f"{up.percent} %"),
        ("downward share", f"{Estimate(1 - up.value, up.error).percent} %"),
    ]
    for name in PLANES:
        rows.append((f"beam angle {name} (50 %)", f"{figures.beam_angles[name]}°"))
        rows.append((f"field angle {name} (10 %)", f"{figures.field_angles[name]}°"))
    for name, values in figures.luminance.items():
        heading = f"luminance {name}, {'; '.join(f'{gamma}°' for gamma in GLARE_ANGLES)}"
        rows.append((heading, f"{'; '.join(map(str, values))} cd/m²"))
    temperature, catalogue = figures.colour_temperature, _NEEDS_UGR
    if ugr is not None:
        crosswise, endwise = ugr[CATALOGUE_ROOM, [0, len(REFLECTANCES)]]
        catalogue = f"{_rating(crosswise)} crosswise, {_rating(endwise)} endwise"
    # Plus 0: no negative zero.
    centre = ", ".join(f"{round(each, 4) + 0.0:.4g}" for each in figures.opening_centre)
    rows += [
        ("colour temperature", "not known" if temperature is None else f"{temperature} K"),
        ("Duv", "not known" if figures.duv is None else str(figures.duv)),
        *_colour_rows(figures),
        ("UGR, 4H x 8H, 70/50/20", catalogue),
        ("luminous opening", str(figures.opening)),
        ("centre of the opening", f"{centre} m from the centre of the bounding box"),
        ("size of the bounding box", " x ".join(f"{side:.4g}" for side in size) + " m"),
        ("angular step", f"{step:g}°"),
        *([("rays", f"{rays:,}")] if rays else []),
    ]
    return rows


def known_rows(rows: Sequence[tuple[str, str]]) -> list[tuple[str, str]]:
    """`figure_rows` without rows about packages missing here, for readers elsewhere."""
    return [row for row in rows if row[1] not in (_NEEDS_UGR, _NEEDS_COLOUR)]


def _colour_rows(figures: PhotometricFigures) -> list[tuple[str, str]]:
    """Rows of the bare emitters' spectrum, or one that says why there are none."""
    colour, share = figures.emitted_colour, figures.spectrum_share
    if colour is None:
        why = "no spectrum of the emitters is stated"
        if share > 0:
            why = f"emitters with {1 - share:.1%} of the flux have RGB colours, no spectrum"
        return [("colour rendering", f"not known: {why}")]
    kelvin, rendering = colour.colour_temperature, colour.rendering
    cct = "not defined" if kelvin is None else f"{kelvin:,.0f} K"
    rows = [("CCT of the emitters", f"{cct}, Duv {colour.duv:.4f}, by their spectrum")]
    if kelvin is not None:
        cri = tm30 = _NEEDS_COLOUR
        if rendering is not None:
            cri = f"Ra {rendering.ra:.0f}, R9 {rendering.r9:.0f}"
            tm30 = f"Rf {rendering.rf:.0f}, Rg {rendering.rg:.0f}"
        rows += [("CRI of the emitters", cri), ("TM-30 of the emitters", tm30)]
    return [*rows, ("colour shift by the lamp", f"{colour.shift:.4f} in (u', v')")]


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
    rows = []
    for limit in limits:
        distance, difference = "too few rays", "dark"
        if limit.distance is not None:
            distance = f"{limit.distance:.3g} m"
        elif limit.is_known:
            distance = "beyond 30 x the size"
        if limit.difference is not None and limit.difference_error is not None:
            difference = f"{Estimate(limit.difference, limit.difference_error).percent} %"
        rows.append((limit.direction, f"{limit.candela:.4g} cd", distance, difference))
    return rows
