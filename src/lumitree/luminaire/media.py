"""Participating media of a scene."""

from typing import Any

import numpy as np

from lumitree.core.backend import load_mitsuba

# Smallest extinction of a channel of a medium, relative to its largest one.
_CLEAR = 1e-5
_EXTINCTION = "sigma_t.value.value"


def media(scene: Any) -> list[Any]:
    """Every mi.Medium inside or around a shape of a mi.Scene, or around a camera of it."""
    found = [sensor.get_medium() for sensor in scene.sensors()]
    for shape in scene.shapes():
        if shape.is_medium_transition():
            found += [shape.interior_medium(), shape.exterior_medium()]
    return [medium for medium in found if medium is not None]


def any_scatters(scene: Any) -> bool:
    """Whether some medium of a mi.Scene does more than to absorb light evenly."""
    return any(absorption(medium) is None for medium in media(scene))


def any_heterogeneous(scene: Any) -> bool:
    """Whether some medium of a mi.Scene is not the same everywhere."""
    return not all(medium.is_homogeneous() for medium in media(scene))


def absorption(medium: Any) -> list[float] | None:
    """Absorption [3] of a mi.Medium per unit of length; None if it does more than to absorb."""
    if not medium.is_homogeneous():
        return None
    scattering, _, extinction = _coefficients(medium)
    return None if np.ravel(scattering).any() else np.ravel(extinction).tolist()


def is_coloured(medium: Any) -> bool:
    """Whether a homogeneous mi.Medium takes more of one channel than of another."""
    return bool(np.ptp(np.ravel(_coefficients(medium)[2])) > 0)


def keep_clear_channels(scene: Any) -> None:
    """Increase extinctions of 0.

    With an extinction of 0, `volpath` divides 0 by 0, and `volpathmis` loses scattered light.
    """
    mi = load_mitsuba()
    for medium in media(scene):
        parameters = mi.traverse(medium)
        # Heterogeneous and grey media have no such parameter.
        if _EXTINCTION in parameters:
            extinction = np.ravel(parameters[_EXTINCTION])
            lifted = np.maximum(extinction, _CLEAR * extinction.max())
            if (lifted > extinction).any():
                parameters[_EXTINCTION] = mi.Color3f(*lifted.tolist())
                parameters.update()


def _coefficients(medium: Any) -> tuple[Any, Any, Any]:
    """Scattering, null and total extinction of a homogeneous medium: any point will do."""
    mi = load_mitsuba()
    # Not at the top: Dr.Jit looks for its library when it is imported.
    import drjit as dr

    anywhere = dr.zeros(mi.MediumInteraction3f)
    return medium.get_scattering_coefficients(anywhere)
