"""Spectral power distributions (SPD) of light, sampled at `core.photometry.WAVELENGTHS`."""

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.photometry import WAVELENGTHS
from lumitree.errors import LumitreeError

# nm between the wavelengths, and how many a finer spectrum may have.
_STEP = 1.0
_MAX_SAMPLES = 1 << 20


def sampled_spectrum(
    wavelengths: ArrayLike, values: ArrayLike, *, means: bool = False
) -> NDArray[np.float64]:
    """A spectrum at `WAVELENGTHS`.

    It is linear between the wavelengths that are given, and 0 beyond them. If some are less than
    1 nm apart, each value of the result is a mean over 1 nm, so that narrow lines keep their power.

    Args:
        wavelengths: [N] nm, increasing.
        values: [N] power per nm in any unit, at least 0. A single one is the power of a line, which
            is divided between the two wavelengths next to it.
        means: whether values are means in any case, so that their sum is the power.

    Returns:
        [471] power per nm; what is invisible is left out.

    Raises:
        LumitreeError: there are no values or more than 2²⁰; a number is NaN, infinite or negative;
            or the wavelengths do not increase.
    """
    wavelengths, values = np.asarray(wavelengths, np.float64), np.asarray(values, np.float64)
    if wavelengths.shape != values.shape or not 1 <= values.size <= _MAX_SAMPLES:
        raise LumitreeError(
            f"a spectrum has {wavelengths.size} wavelengths and {values.size} values; expected as "
            f"many of both, 1 to {_MAX_SAMPLES}"
        )
    numbers = np.isfinite(wavelengths).all() and np.isfinite(values).all()
    if not numbers or not (values >= 0).all() or not (np.diff(wavelengths) > 0).all():
        raise LumitreeError(
            "the wavelengths of a spectrum do not increase, or a value is negative, NaN or infinite"
        )
    if values.size == 1:
        return values * np.maximum(1 - np.abs(WAVELENGTHS - wavelengths) / _STEP, 0)
    if not means and np.diff(wavelengths).min() >= _STEP:
        return np.interp(WAVELENGTHS, wavelengths, values, left=0, right=0)
    return _means(wavelengths, values)


def _means(wavelengths: NDArray[np.float64], values: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over 1 nm around each of `WAVELENGTHS`: differences of the exact integral."""
    edges = np.append(WAVELENGTHS - _STEP / 2, WAVELENGTHS[-1] + _STEP / 2)
    # The integral is quadratic between the nodes; with the edges as nodes it is exact at them.
    nodes = np.union1d(wavelengths, edges[(edges > wavelengths[0]) & (edges < wavelengths[-1])])
    heights = np.interp(nodes, wavelengths, values)
    integral = np.append(0, np.cumsum(np.diff(nodes) * (heights[1:] + heights[:-1]) / 2))
    return np.diff(np.interp(edges, nodes, integral)) / _STEP
