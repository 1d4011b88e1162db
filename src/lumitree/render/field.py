"""A baked field on the device, and the exact integral of Eq. 3 along a ray.

Symbols
    grid        the finest cells of the octree, n = 2**tree_depth a side, n³ in all
    o, d        ray origin and direction in grid units; t stays in local units of length
    cell        integer grid coordinates of the finest cell the ray is in
    tau, T      optical depth and transmittance so far
"""

import os
import weakref
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.asset.file import load
from lumitree.asset.model import LuminaireAsset
from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis, num_coefficients
from lumitree.core.transmittance import BLOCKED, transmittance

_OPEN: "weakref.WeakValueDictionary[tuple[Any, ...], Field]" = weakref.WeakValueDictionary()


class Field:
    """Device copy of an asset's octree.

    The integral is exact by default: it stops only where the linear law's transmittance is 0 or
    the exponential law's is below 1e-3.

    Args:
        asset: what to render.
        min_density: leaves below this density (per local unit) count as empty; the paper: 0.1.
        max_opacity: rays stop at this opacity; the paper: 0.9.
    """

    def __init__(
        self, asset: LuminaireAsset, min_density: float = 0.0, max_opacity: float = 1.0
    ) -> None:
        self.asset = asset
        self._min_density = min_density
        self._blocked = max(1.0 - max_opacity, 0.0 if asset.law == "linear" else BLOCKED)
        self._children = mi.Int32(asset.children.ravel())
        # Device arrays cannot be empty: an asset without leaves gets one that nothing refers to.
        self._density = mi.Float(asset.density if asset.num_leaves else [0.0])
        self._coefficients = mi.Float16(asset.coefficients.ravel() if asset.num_leaves else [0.0])
        dr.eval(self._children, self._density, self._coefficients)

    def emission(self, origin: Any, direction: Any, active: Any = True) -> tuple[Any, Any]:
        """Emitted radiance L_e (Eq. 3) and transmittance T (Eq. 4) of the line through the proxy.

        Args:
            origin: mi.Point3f, any point of the line, local units.
            direction: mi.Vector3f, unit direction of travel, local frame.
            active: mi.Bool mask.

        Returns:
            mi.Color3f, radiance units of the luminaire's scene; mi.Float in [0, 1].
        """
        return self._integrate(origin, direction, mi.Bool(active), with_emission=True)

    def transmittance(self, origin: Any, direction: Any, active: Any = True) -> Any:
        """Transmittance T (Eq. 4) alone; arguments as for `emission`."""
        return self._integrate(origin, direction, mi.Bool(active), with_emission=False)[1]

    @dr.syntax
    def _integrate(self, origin, direction, active, with_emission):
        size = 1 << self.asset.tree_depth
        o = (origin + 1) * (size / 2)
        d = direction * (size / 2)
        moving = dr.abs(d) > 1e-18
        inverse = dr.rcp(dr.select(moving, d, 1))
        t, t_end, inside = self._clip(o, moving, inverse)
        active = active & inside & (t < t_end)
        cell = mi.Vector3i(dr.clip(mi.Vector3i(dr.floor(o + t * d)), 0, size - 1))

        y = basis(*towards_viewer(direction), self.asset.l_max) if with_emission else []
        radiance = mi.Color3f(0)
        tau = mi.Float(0)
        through = mi.Float(1)

        while active:
            child, lower, side = self._find_cell(cell, active)
            plane = mi.Vector3f(dr.select(d > 0, lower + side, lower))
            t_planes = dr.select(moving, (plane - o) * inverse, dr.inf)
            t_exit = dr.minimum(dr.min(t_planes), t_end)
            length = dr.maximum(t_exit - t, 0)

            is_leaf = active & (child < 0)
            leaf = mi.UInt32(~child)
            density = dr.gather(mi.Float, self._density, leaf, is_leaf)
            if dr.hint(self._min_density > 0, mode="scalar"):
                density = dr.select(density < self._min_density, 0, density)
            tau += density * length
            after = transmittance(tau, self.asset.law, dr)
            if dr.hint(with_emission, mode="scalar"):
                weight = through - after
                lit = is_leaf & (weight > 0)
                radiance[lit] = radiance + weight * self._leaf_emission(leaf, y, lit)
            through = mi.Float(after)

            stepped = dr.clip(mi.Vector3i(dr.floor(o + t_exit * d)), lower, lower + side - 1)
            beyond = dr.select(d > 0, lower + side, lower - 1)
            cell = mi.Vector3i(dr.select(t_planes <= t_exit, beyond, stepped))
            t = dr.maximum(t, t_exit)
            active &= (
                (t_exit < t_end) & (through > self._blocked) & dr.all((cell >= 0) & (cell < size))
            )
        return radiance, through

    def _clip(self, o, moving, inverse):
        """Entry and exit distance of the proxy box, and whether the line meets it."""
        half = mi.Vector3f(*self.asset.half_extents.tolist())
        scale = (1 << self.asset.tree_depth) / 2
        first = ((1 - half) * scale - o) * inverse
        second = ((1 + half) * scale - o) * inverse
        entry = dr.max(dr.select(moving, dr.minimum(first, second), -dr.inf))
        exit_ = dr.min(dr.select(moving, dr.maximum(first, second), dr.inf))
        beside = ~moving & ((o < (1 - half) * scale) | (o >= (1 + half) * scale))
        return entry, exit_, ~dr.any(beside)

    def _find_cell(self, cell, active):
        """Deepest node's child entry that holds `cell`, its lower corner and side (grid units).

        Descends from the root; an empty entry of any level is as large as that level's cells,
        which is how empty space is skipped.
        """
        depth = self.asset.tree_depth
        node = mi.Int32(0)
        side = mi.Int32(1 << depth)
        open_ = mi.Bool(active)
        for level in range(1, depth + 1):
            shift = depth - level
            bits = (cell >> shift) & 1
            octant = bits.x + 2 * bits.y + 4 * bits.z
            child = dr.gather(mi.Int32, self._children, mi.UInt32(node * 8 + octant), open_)
            node = dr.select(open_, child, node)
            side = dr.select(open_, 1 << shift, side)
            open_ &= child > 0
        return node, cell & ~(side - 1), side

    def _leaf_emission(self, leaf, y, active):
        """Φ of Eq. 6 for leaves [index], with the basis values `y` of the ray."""
        count = num_coefficients(self.asset.l_max)
        channels = []
        for channel in range(3):
            total = mi.Float(0)
            for k in range(count):
                index = leaf * (3 * count) + (channel * count + k)
                value = dr.gather(mi.Float16, self._coefficients, index, active)
                total = dr.fma(mi.Float(value), y[k], total)
            channels.append(dr.rcp(1 + dr.exp(-total)))
        return self.asset.max_radiance * mi.Color3f(*channels)


def open_field(
    path: str | os.PathLike[str], min_density: float = 0.0, max_opacity: float = 1.0
) -> Field:
    """Field of an asset file; instances that are alive at the same time share one copy."""
    path = Path(path).resolve()
    stamp = path.stat() if path.exists() else None
    key = (
        path,
        stamp and (stamp.st_mtime_ns, stamp.st_size),
        mi.variant(),
        min_density,
        max_opacity,
    )
    field = _OPEN.get(key)
    if field is None:
        field = _OPEN[key] = Field(load(path), min_density, max_opacity)
    return field
