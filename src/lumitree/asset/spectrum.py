"""The spectrum of the emitters of a luminaire, which its asset keeps beside its RGB light."""

import dataclasses
import functools
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.checks import expect, expect_arrays
from lumitree.core.photometry import WAVELENGTHS
from lumitree.core.reading import Record

SPECTRUM_TENSORS = {"spectrum.power": "F32"}
# Fraction of the luminous flux that must have a known spectrum before the lamp gets one.
_WHOLE = 0.999
_expect = functools.partial(expect, "spectrum")


@dataclasses.dataclass(frozen=True, eq=False)
class EmittedSpectrum:
    """The spectral power distribution of the light of a luminaire's bare emitters.

    It is the sum over those emitters whose spectra are known, weighted by their luminous flux. What
    glass and surfaces of the luminaire do to the light is in the RGB of the asset alone.

    Attributes:
        power: float32 [471], power per nm at 360 to 830 nm, 1 nm apart, relative; the largest is 1.
        share: part of the luminous flux of all bare emitters that these emitters have, above 0 and
            at most 1.

    Raises:
        LumitreeError: a member has a wrong type, shape or range.
    """

    power: NDArray[np.float32]
    share: float = 1.0

    def __post_init__(self) -> None:
        """Refuse anything that is no spectrum."""
        expect_arrays("spectrum", {"power": (self.power, np.float32, WAVELENGTHS.shape)})
        _expect(
            ((self.power >= 0) & (self.power <= 1)).all() and self.power.max() == 1,
            "power is not 0 to 1 with 1 as the largest",
        )
        _expect(
            type(self.share) is float and 0 < self.share <= 1,
            f"share {self.share!r}, expected a number above 0, at most 1",
        )

    @property
    def is_whole(self) -> bool:
        """Whether it includes all emitters, but for a thousandth of their luminous flux."""
        return self.share >= _WHOLE

    @staticmethod
    def of(power: NDArray[np.float64], share: float = 1.0) -> "EmittedSpectrum | None":
        """The spectrum of power per nm [471] in any unit; None if all of it is 0.

        `share` is as in `EmittedSpectrum`.
        """
        largest = power.max()
        return EmittedSpectrum((power / largest).astype(np.float32), share) if largest > 0 else None


def spectrum_tensors(spectrum: EmittedSpectrum) -> dict[str, NDArray[Any]]:
    """Tensors of a spectrum, by name."""
    return {"spectrum.power": spectrum.power}


def spectrum_description(spectrum: EmittedSpectrum) -> dict[str, Any]:
    """Description of a spectrum in the file, besides its tensor."""
    return {"share": spectrum.share}


def build_spectrum(description: Record, tensors: dict[str, NDArray[Any]]) -> EmittedSpectrum:
    """The spectrum of a file; the inverse of `spectrum_tensors` and `spectrum_description`."""
    description.expect_keys("share")
    return EmittedSpectrum(tensors["spectrum.power"], description.number("share"))
