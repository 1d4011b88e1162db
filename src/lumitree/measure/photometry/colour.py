"""Colour rendering of the spectrum of a luminaire's emitters.

CRI is the general and a special colour rendering index of CIE 13.3-1995, TM-30 the fidelity and the
gamut index of ANSI/IES TM-30-18. The package `colour-science` computes both; it is optional. No
figure of colour rendering follows from RGB.
"""

import dataclasses
import math
import warnings

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import EmittedSpectrum
from lumitree.core.photometry import (
    WAVELENGTHS,
    chromaticity_difference,
    xyz_from_srgb,
    xyz_of_spectrum,
    xyz_temperature,
)


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
            that leaves the luminaire and the colour of the spectrum. Glass, surfaces and a gain
            cause it, and for saturated colours the gamut of sRGB.
    """

    colour_temperature: float | None
    duv: float
    rendering: RenderingIndices | None
    shift: float


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
        # Of parts of the package that are not used here, and of interpolation.
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
