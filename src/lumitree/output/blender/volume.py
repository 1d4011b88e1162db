"""The field of an asset as voxels for OpenVDB: density and emission."""

import io
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.frames import similarity
from lumitree.core.harmonics import basis_array
from lumitree.errors import LumitreeError
from lumitree.octree.leaves import leaf_cells

# Directions of the mean over the sphere, and leaves whose values are in memory at a time.
_DIRECTIONS, _CHUNK = 256, 4096


def volume_arrays(asset: Asset, z_up: NDArray[np.float64]) -> dict[str, NDArray[Any]]:
    """Boxes of voxels of equal values.

    Args:
        z_up: [3, 3] rotation from the frame of the luminaire's file.

    Returns:
        `first` and `last` int32 [M, 3], the corner voxels of each leaf; `density` float32 [M],
        absorption per unit of length of the file; `emission` float32 [M, 3], emission coefficient,
        W/(m³ sr) for metres: density times the mean of the emitted radiance over all directions;
        and `transform` float64 [4, 4], which takes an index of a voxel to its centre.

    Raises:
        LumitreeError: the asset has no field.
    """
    if not asset.num_leaves:
        raise LumitreeError(
            f"the asset of {asset.luminaire} has no field, which a .vdb file holds; bake its "
            "luminaire with the part field (a photometric file has none: export it as .py)"
        )
    cells, levels = leaf_cells(asset.children, asset.num_leaves)
    voxels = 1 << (asset.tree_depth - levels[:, None])
    frame, side = asset.frame, 2.0 / (1 << asset.tree_depth)
    local = similarity(np.eye(3), side, np.full(3, side / 2 - 1))
    turn = np.eye(4)
    turn[:3, :3] = z_up
    density = asset.density.astype(np.float64) / float(frame.scale)
    return {
        "first": (cells * voxels).astype(np.int32),
        "last": ((cells + 1) * voxels - 1).astype(np.int32),
        "density": density.astype(np.float32),
        "emission": (density[:, None] * mean_emission(asset)).astype(np.float32),
        "transform": turn @ frame.world_from_local @ local,
    }


def mean_emission(asset: Asset) -> NDArray[np.float64]:
    """Mean [M, 3] of the radiance that each leaf emits over all directions, W/(m² sr)."""
    # A spherical Fibonacci lattice.
    index = np.arange(_DIRECTIONS) + 0.5
    height, angle = 1 - 2 * index / _DIRECTIONS, np.pi * (1 + 5**0.5) * index
    flat = np.sqrt(1 - height**2)
    directions = np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=-1)
    y = basis_array(directions, asset.l_max)
    means = []
    for start in range(0, asset.num_leaves, _CHUNK):
        logit = asset.coefficients[start : start + _CHUNK].astype(np.float64) @ y.T
        # exp may overflow to infinity, of which the reciprocal is 0, as it should be.
        with np.errstate(over="ignore"):
            means.append((1 / (1 + np.exp(-logit))).mean(axis=-1))
    return asset.max_radiance * np.array(asset.gain) * np.concatenate(means)


def pack_volume(asset: Asset, z_up: NDArray[np.float64]) -> bytes:
    """The arrays as an archive of NumPy, for `vdb_script`."""
    content = io.BytesIO()
    np.savez(content, **volume_arrays(asset, z_up))  # type: ignore[arg-type]
    return content.getvalue()


def lost_in_volumes(asset: Asset) -> list[str]:
    """One line for each property of the field that a volume has not."""
    lost = ["the volume emits the same in all directions: the mean of each leaf"]
    if asset.law == "linear":
        lost.append("the field has the linear law of transmittance, volumes the exponential one")
    return lost
