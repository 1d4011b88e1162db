"""A baked field on the device, and the exact integral of Eq. 3 along a ray.

Symbols
    tau, T      optical depth and transmittance so far
"""

import functools
import os
import weakref
from collections.abc import Callable
from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.asset.file import load
from lumitree.asset.model import LuminaireAsset
from lumitree.asset.traversal import Octree
from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis, num_coefficients
from lumitree.core.transmittance import BLOCKED, transmittance
from lumitree.render.light_boxes import LightBoxes

Record = Callable[[Any, Any, Any], None]
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
        self._octree = Octree(asset.children, asset.tree_depth, asset.half_extents)
        # Device arrays cannot be empty: an asset without leaves gets one that nothing refers to.
        self._density = mi.Float(asset.density if asset.num_leaves else [0.0])
        self._coefficients = mi.Float16(asset.coefficients.ravel() if asset.num_leaves else [0.0])
        dr.eval(self._density, self._coefficients)

    @functools.cached_property
    def light_boxes(self) -> LightBoxes:
        """What emitters are sampled with; made on first use, shared by all instances."""
        return LightBoxes(self)

    def emission(
        self, origin: Any, direction: Any, active: Any = True, record: Record | None = None
    ) -> tuple[Any, Any]:
        """Emitted radiance L_e (Eq. 3) and transmittance T (Eq. 4) of the line through the proxy.

        Args:
            origin: mi.Point3f, any point of the line, local units.
            direction: mi.Vector3f, unit direction of travel, local frame.
            active: mi.Bool mask.
            record: told the light of each leaf: called with the distance of the middle of the
                line's stretch in it, its part of the radiance, and a mask.

        Returns:
            mi.Color3f, radiance units of the luminaire's scene; mi.Float in [0, 1].
        """
        return self._integrate(origin, direction, mi.Bool(active), True, record)

    def transmittance(self, origin: Any, direction: Any, active: Any = True) -> Any:
        """Transmittance T (Eq. 4) alone; arguments as for `emission`."""
        return self._integrate(origin, direction, mi.Bool(active), with_emission=False)[1]

    def _integrate(self, origin, direction, active, with_emission, record=None):
        y = basis(*towards_viewer(direction), self.asset.l_max) if with_emission else []

        def visit(state, leaf, start, length, active):
            radiance, tau, through = state
            density = dr.gather(mi.Float, self._density, leaf, active)
            if self._min_density > 0:
                density = dr.select(density < self._min_density, 0, density)
            tau = tau + density * length
            after = mi.Float(transmittance(tau, self.asset.law, dr))
            if with_emission:
                weight = through - after
                lit = active & (weight > 0)
                emission = weight * self._leaf_emission(leaf, y, lit)
                radiance = dr.select(lit, radiance + emission, radiance)
                if record is not None:
                    record(start + length / 2, emission, lit)
            return (radiance, tau, after), after > self._blocked

        state = (mi.Color3f(0), mi.Float(0), mi.Float(1))
        radiance, _, through = self._octree.walk(origin, direction, active, visit, state)
        return radiance, through

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
