"""Real spherical harmonics up to l = 4, for NumPy, JAX and Dr.Jit arrays.

They are orthonormal on the sphere, have no Condon-Shortley phase, and are ordered by l, then by m
from -l to l.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

MAX_L = 4
# The value of the constant function of band 0.
Y_00 = 0.28209479177387814


def num_coefficients(l_max: int) -> int:
    """Number of coefficients of bands 0 to `l_max`."""
    return (l_max + 1) ** 2


def basis(x: Any, y: Any, z: Any, l_max: int) -> list[Any]:
    """Values of the basis at the unit direction (x, y, z).

    Args:
        x, y, z: components of the direction; arrays of one library and of equal shape.
        l_max: highest band, 0 to 4.

    Returns:
        List of (l_max + 1)² arrays of the components' shape. Polynomials: Sloan, "Stupid
        Spherical Harmonics (SH) Tricks", 2008, appendix A2.
    """
    if not 0 <= l_max <= MAX_L:
        raise ValueError(f"l_max is {l_max}; expected 0 to {MAX_L}")
    values = [Y_00 + 0.0 * x]
    if l_max >= 1:
        c = 0.4886025119029199
        values += [c * y, c * z, c * x]
    xx, yy, zz = x * x, y * y, z * z
    if l_max >= 2:
        c = 1.0925484305920792
        values += [
            c * x * y,
            c * y * z,
            0.31539156525252005 * (3 * zz - 1),
            c * x * z,
            0.5462742152960396 * (xx - yy),
        ]
    if l_max >= 3:
        values += [
            0.5900435899266435 * y * (3 * xx - yy),
            2.890611442640554 * x * y * z,
            0.4570457994644658 * y * (5 * zz - 1),
            0.37317633259011546 * z * (5 * zz - 3),
            0.4570457994644658 * x * (5 * zz - 1),
            1.445305721320277 * z * (xx - yy),
            0.5900435899266435 * x * (xx - 3 * yy),
        ]
    if l_max >= 4:
        values += [
            2.5033429417967046 * x * y * (xx - yy),
            1.7701307697799304 * y * z * (3 * xx - yy),
            0.9461746957575601 * x * y * (7 * zz - 1),
            0.6690465435572892 * y * z * (7 * zz - 3),
            0.10578554691520431 * (zz * (35 * zz - 30) + 3),
            0.6690465435572892 * x * z * (7 * zz - 3),
            0.47308734787878004 * (xx - yy) * (7 * zz - 1),
            1.7701307697799304 * x * z * (xx - 3 * yy),
            0.6258357354491761 * (xx * (xx - 3 * yy) - yy * (3 * xx - yy)),
        ]
    return values


def basis_array(directions: NDArray[Any], l_max: int) -> NDArray[Any]:
    """Basis values [..., (l_max + 1)²] at unit directions [..., 3] (NumPy)."""
    x, y, z = (directions[..., axis] for axis in range(3))
    return np.stack(basis(x, y, z, l_max), axis=-1)
