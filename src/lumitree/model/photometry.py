"""Radiometry to photometry and back: luminance, luminous flux, colour temperature.

lumitree's convention: a radiance (R, G, B) in W/(m² sr), linear sRGB primaries, has the luminance
683 lm/W x (0.2126 R + 0.7152 G + 0.0722 B) cd/m². A Lambertian surface of area A emits a
luminous flux of π A times its luminance.
"""

import math
from collections.abc import Sequence

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.core.device import on_device
from lumitree.model.model import RGB

# Maximum luminous efficacy, lm/W.
LUMENS_PER_WATT = 683.0
# Luminance of the linear sRGB primaries (ITU-R BT.709).
LUMA: RGB = (0.2126, 0.7152, 0.0722)
MIN_TEMPERATURE, MAX_TEMPERATURE = 1000.0, 20000.0

_SRGB_FROM_XYZ = np.array(
    [
        [3.2404542, -1.5371385, -0.4985314],
        [-0.9692660, 1.8760108, 0.0415560],
        [0.0556434, -0.2040259, 1.0572252],
    ]
)


def luminance(rgb: ArrayLike) -> NDArray[np.float64]:
    """Photometric [...] of a radiometric quantity [..., 3] in R, G and B: W becomes lm."""
    return LUMENS_PER_WATT * (np.asarray(rgb, np.float64) @ np.array(LUMA))


def flux_from_radiance(radiance: Sequence[float], area: float) -> float:
    """Luminous flux, lm, of a Lambertian surface.

    Args:
        radiance: R, G and B in W/(m² sr).
        area: in m².
    """
    return math.pi * area * float(luminance(radiance))


def radiance_from_flux(lumens: float, area: float, colour: Sequence[float]) -> RGB:
    """Radiance, W/(m² sr), of a Lambertian surface of `area` m² that emits `lumens`.

    Args:
        colour: linear RGB; only its ratios matter.
    """
    factor = lumens / flux_from_radiance(colour, area)
    return (factor * colour[0], factor * colour[1], factor * colour[2])


def blackbody_colour(temperature: float) -> RGB:
    """Linear sRGB colour, of luminance 1, of a black body; clipped at 0 outside the gamut.

    Args:
        temperature: in kelvin, from 1000 to 20000.
    """
    wavelength = np.arange(360.0, 831.0)
    # Planck's law up to a factor; 1.438777e7 nm K is hc/k.
    spectrum = wavelength**-5 / np.expm1(1.438777e7 / (wavelength * temperature))
    mi = load_mitsuba()
    matching = np.array(mi.cie1931_xyz(on_device(mi.Float, wavelength)), np.float64)
    rgb = np.maximum(_SRGB_FROM_XYZ @ (matching @ spectrum), 0.0)
    rgb /= rgb @ LUMA
    return (float(rgb[0]), float(rgb[1]), float(rgb[2]))
