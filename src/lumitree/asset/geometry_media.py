"""Homogeneous media of an asset's geometry: three numbers, or an object if they scatter light.

A medium that only absorbs is its absorption [3]. One that scatters is an object with exactly the
keys `absorption` [3], `scattering` [3] and `anisotropy`, the mean cosine of the scattering angle
(Henyey-Greenstein). Coefficients are for R, G and B, per unit of length of the luminaire's
file.
"""

from typing import Any, NamedTuple

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.checks import require
from lumitree.asset.textures import Json
from lumitree.core.reading import Record

# Sides of a surface: where its normal points away from, and where to.
MEDIA_SIDES = ("interior", "exterior")
_KEYS = ("absorption", "scattering", "anisotropy")
# Per unit of length.
_MAX_COEFFICIENT = 1e15
# Beyond it single precision has no values of the phase function.
MAX_ANISOTROPY = 0.999


class SideMedium(NamedTuple):
    """The medium on one side of a shape.

    Attributes:
        absorption, scattering: float64 [3], per unit of length of the luminaire's file.
        anisotropy: mean cosine of the scattering angle.
    """

    absorption: NDArray[np.float64]
    scattering: NDArray[np.float64]
    anisotropy: float


def side_medium(value: Any) -> SideMedium:
    """The medium that a member `interior` or `exterior` of a shape describes."""
    if not isinstance(value, dict):
        return SideMedium(np.array(value, np.float64), np.zeros(3), 0.0)
    absorption, scattering = (np.array(value[key], np.float64) for key in _KEYS[:2])
    return SideMedium(absorption, scattering, float(value["anisotropy"]))


def described_medium(medium: SideMedium) -> Any:
    """The member of a shape for a medium; the inverse of `side_medium`."""
    absorption, scattering, anisotropy = medium
    if not scattering.any():
        return absorption.tolist()
    return dict(zip(_KEYS, (absorption.tolist(), scattering.tolist(), anisotropy), strict=True))


def check_medium(record: Record, side: str, of: str) -> None:
    """Refuse an invalid medium; `side` is its key in the record of a shape of type `of`."""
    if not record.is_object(side):
        _check_coefficient(record, side, f"{side} of a {of}")
        return
    medium = record.record(side)
    medium.expect_keys(*_KEYS)
    for key in _KEYS[:2]:
        _check_coefficient(medium, key, f"{key} of the {side} of a {of}")
    require(
        medium.array("scattering", 3).any(),
        f"the {side} of a {of} scatters nothing; expected its absorption alone",
    )
    anisotropy = medium.number("anisotropy")
    require(
        abs(anisotropy) <= MAX_ANISOTROPY,
        f"anisotropy of the {side} of a {of} is {anisotropy:g}, expected -{MAX_ANISOTROPY:g} to "
        f"{MAX_ANISOTROPY:g}",
    )


def scattering_sides(shape: Json) -> list[str]:
    """The sides of a shape whose medium scatters light."""
    return [side for side in MEDIA_SIDES if isinstance(shape.get(side), dict)]


def _check_coefficient(record: Record, key: str, what: str) -> None:
    values = record.array(key, 3)
    require(
        bool(((values >= 0) & (values <= _MAX_COEFFICIENT)).all()),
        f"{what} is {values.tolist()}, expected 0 to {_MAX_COEFFICIENT:g}",
    )
