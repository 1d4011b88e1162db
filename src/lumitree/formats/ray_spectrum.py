"""The spectrum of all rays of a TM-25 file together."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.photometry import WAVELENGTHS, matching_functions, sampled_spectrum
from lumitree.errors import LumitreeError

# Kinds of spectral data, as the file's header numbers them.
_ONE_WAVELENGTH, _WAVELENGTHS, _ONE_TABLE, _TABLES = 1, 2, 3, 4


def rays_spectrum(
    items: dict[str, NDArray[np.float64]],
    tables: list[NDArray[np.float64]],
    kind: int,
    wavelength: float,
) -> NDArray[np.float64] | None:
    """Power per nm of all rays, in any unit.

    Args:
        items: columns of the rays, [N, 1]: "radiant" flux, "luminous" flux or both; and
            "wavelength", nm, or "table", from 1 on.
        tables: [n, 2] wavelengths, nm, and weights each.
        kind: of spectral data: 1 one wavelength, 2 one of each ray, 3 one table, 4 a table of each
            ray; 0 none.
        wavelength: of kind 1, nm.

    Returns:
        [471] at `WAVELENGTHS`; None if the file states no spectrum, or none that can be used. Its
        colours may still be known from tristimulus values.
    """
    try:
        if kind == _ONE_WAVELENGTH:
            return sampled_spectrum([wavelength], [1])
        if kind == _WAVELENGTHS and "wavelength" in items:
            return _lines(items["wavelength"][:, 0], items)
        if kind == _ONE_TABLE and tables:
            return sampled_spectrum(*tables[0].T)
        if kind == _TABLES and tables and "table" in items:
            return _mixture(tables, items["table"][:, 0], items)
    except LumitreeError:
        return None
    return None


def _lines(
    wavelength: NDArray[np.float64], items: dict[str, NDArray[np.float64]]
) -> NDArray[np.float64]:
    """Rays of one wavelength [N] each, divided between the wavelengths next to it."""
    visible = (wavelength >= WAVELENGTHS[0]) & (wavelength <= WAVELENGTHS[-1])
    place = np.where(visible, wavelength - WAVELENGTHS[0], 0)
    efficacy = np.interp(wavelength, WAVELENGTHS, matching_functions()[1], left=0, right=0)
    power = np.where(visible, _power(items, efficacy), 0)
    lower = place.astype(np.int64)
    size = len(WAVELENGTHS) + 1
    parts = (lower, 1 - (place - lower)), (lower + 1, place - lower)
    binned = sum(np.bincount(at, power * part, size) for at, part in parts)
    return np.asarray(binned, np.float64)[:-1]


def _mixture(
    tables: list[NDArray[np.float64]],
    number: NDArray[np.float64],
    items: dict[str, NDArray[np.float64]],
) -> NDArray[np.float64]:
    """Rays with one of several tables each, by its number [N] from 1 on."""
    if not ((number >= 1) & (number <= len(tables))).all():
        raise LumitreeError(f"a ray names none of the {len(tables)} spectral tables")
    index = number.astype(np.int64) - 1
    spectra = np.array([spectrum_of_a_watt(each) for each in tables])
    power = _power(items, (spectra @ matching_functions()[1])[index])
    return np.bincount(index, power, len(tables)) @ spectra


def _power(items: dict[str, NDArray[np.float64]], efficacy: ArrayLike) -> NDArray[np.float64]:
    """Radiant flux [N] of rays whose luminous efficacy [N] is known, relative."""
    if "radiant" in items:
        return items["radiant"][:, 0]
    flux = items["luminous"][:, 0]
    return np.divide(flux, efficacy, out=np.zeros_like(flux), where=np.asarray(efficacy) > 0)


def spectrum_of_a_watt(table: NDArray[np.float64]) -> NDArray[np.float64]:
    """Power per nm [471] at `WAVELENGTHS` of a spectral table; the watt has its invisible light.

    The table is [n, 2] wavelengths, nm, and weights, linear between them; one entry is a line.
    """
    total = np.trapezoid(table[:, 1], table[:, 0]) if len(table) > 1 else table[0, 1]
    return sampled_spectrum(*table.T, means=True) / max(float(total), 1e-300)
