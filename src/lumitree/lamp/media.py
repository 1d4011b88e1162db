"""Participating media of a scene."""

from __future__ import annotations

from collections.abc import Iterable
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.geometry import MAX_ANISOTROPY, Medium
from lumitree.core.backend import load_mitsuba
from lumitree.core.photometry import RGB
from lumitree.errors import LumitreeError

if TYPE_CHECKING:
    import mitsuba as mi

# Smallest extinction of a channel of a medium, relative to its largest one.
_CLEAR = 1e-5
# Where spectra are looked at, nm.
_WAVELENGTHS = (450.0, 520.0, 580.0, 630.0)
_EXTINCTION = "sigma_t.value.value"


def media(scene: mi.Scene) -> list[mi.Medium]:
    """Every mi.Medium inside or around a shape of a mi.Scene, or around a camera of it."""
    found = [sensor.get_medium() for sensor in scene.sensors()]
    return [medium for medium in found if medium is not None] + media_of(scene.shapes())


def media_of(shapes: Iterable[mi.Shape]) -> list[mi.Medium]:
    """Every mi.Medium inside or around one of some shapes."""
    sides = [(s.interior_medium(), s.exterior_medium()) for s in shapes if s.is_medium_transition()]
    return [medium for pair in sides for medium in pair if medium is not None]


def any_scatters(scene: mi.Scene) -> bool:
    """Whether some medium of a mi.Scene does more than to absorb light evenly."""
    return any(map(scatters, media(scene)))


def scatters(medium: mi.Medium) -> bool:
    """Whether a mi.Medium does more than to absorb light evenly."""
    return absorption(medium) is None


def any_heterogeneous(scene: mi.Scene) -> bool:
    """Whether some medium of a mi.Scene is not the same everywhere."""
    return not all(medium.is_homogeneous() for medium in media(scene))


def absorption(medium: mi.Medium) -> list[float] | None:
    """Absorption [3] of a mi.Medium per unit of length; None if it does more than to absorb."""
    if not medium.is_homogeneous():
        return None
    scattering, _, extinction = _coefficients(medium)
    return None if np.ravel(scattering).any() else np.ravel(extinction).tolist()


def stored_medium(medium: mi.Medium) -> Medium:
    """A homogeneous mi.Medium as the geometry of an asset has it."""
    found = [np.ravel(np.array(each, np.float64)) for each in _coefficients(medium)]
    scattering, extinction = found[0], found[2]
    anisotropy = _anisotropy(medium.phase_function()) if scattering.any() else 0.0
    absorption = np.maximum(extinction - scattering, 0)
    return Medium(_rgb(absorption), _rgb(scattering), anisotropy)


def _rgb(values: NDArray[np.float64]) -> RGB:
    red, green, blue = values.tolist()
    return (red, green, blue)


def _anisotropy(phase: mi.Object) -> float:
    kind = phase.class_name()
    if kind == "IsotropicPhaseFunction":
        return 0.0
    if kind != "HGPhaseFunction":
        raise LumitreeError(f"a medium with a {kind} is not stored; expected isotropic or hg")
    value = float(np.ravel(load_mitsuba().traverse(phase)["g"])[0])
    if abs(value) > MAX_ANISOTROPY:
        raise LumitreeError(
            f"a medium has g of {value:g}, which is not stored; expected -{MAX_ANISOTROPY:g} to "
            f"{MAX_ANISOTROPY:g}"
        )
    return value


def is_coloured(medium: mi.Medium) -> bool:
    """Whether a homogeneous mi.Medium takes more of one channel than of another."""
    return bool(np.ptp(np.ravel(_coefficients(medium)[2])) > 0)


def keep_clear_channels(scene: mi.Scene) -> None:
    """Increase extinctions of 0.

    With an extinction of 0, `volpath` divides 0 by 0, and `volpathmis` loses scattered light.
    """
    mi = load_mitsuba()
    if mi.is_spectral:
        # Coefficients are functions of the wavelength, none of which is 0.
        return
    for medium in media(scene):
        parameters = mi.traverse(medium)
        # Heterogeneous and grey media have no such parameter.
        if _EXTINCTION in parameters:
            extinction = np.ravel(parameters[_EXTINCTION])
            lifted = np.maximum(extinction, _CLEAR * extinction.max())
            if (lifted > extinction).any():
                parameters[_EXTINCTION] = mi.Color3f(*lifted.tolist())
                parameters.update()


def _coefficients(medium: mi.Medium) -> tuple[mi.Spectrum, mi.Spectrum, mi.Spectrum]:
    """Scattering, null and total extinction of a homogeneous medium, at any point."""
    mi = load_mitsuba()
    # Not at the top: Dr.Jit looks for its library when it is imported.
    import drjit as dr

    anywhere = dr.zeros(mi.MediumInteraction3f)
    if mi.is_spectral:
        anywhere.wavelengths = mi.Spectrum(*_WAVELENGTHS)
    return medium.get_scattering_coefficients(anywhere)
