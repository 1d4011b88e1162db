"""Emission of a lamp that is divided into what receivers get and what an image shows (D12)."""

from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.asset.asset import Asset
from lumitree.octree.field import Field
from lumitree.rendering.emitter_sampling import EmitterSampler, Sampling
from lumitree.rendering.exitant_light import exitant_light
from lumitree.rendering.light_leaves import light_leaves
from lumitree.rendering.proxy import Proxy


def emitter_sampler(
    asset: Asset, field: Field, proxy: Proxy, sampling: Sampling = "emission"
) -> "EmitterSampler | DividedSampler":
    """Sampler of what an asset emits; arguments as for `EmitterSampler` and `lumitree.shape`."""
    uniform = sampling == "uniform"
    if asset.exitant is None:
        return EmitterSampler(proxy, field, None if uniform else light_leaves(field))
    return DividedSampler(asset, field, proxy if uniform else None)


def look(asset: Asset, field: Field, origin: Any, direction: Any, active: Any) -> tuple[Any, Any]:
    """Radiance and transmittance of a lamp in an image, as `Field.emission`.

    An asset whose field is empty shows its exitant light field, which hides nothing.
    """
    if asset.exitant is None or asset.num_leaves:
        return field.emission(origin, direction, active)
    light = exitant_light(asset.exitant, asset.frame.half_extents)
    radiance, _ = light.eval(origin, origin, direction, mi.Float(0), active)
    return radiance, dr.full(mi.Float, 1, dr.width(radiance))


class DividedSampler:
    """As `EmitterSampler`, for a lamp with an exitant light field.

    Directions are sampled by the exitant light field. It is also the radiance that receivers get.
    Images show the field, as `look` has it.

    Args:
        asset: has an exitant light field.
        field: of the asset.
        uniform: proxy whose directions are sampled uniformly, instead of by emission.
    """

    def __init__(self, asset: Asset, field: Field, uniform: Proxy | None = None) -> None:
        assert asset.exitant is not None
        self._asset, self._field, self._uniform = asset, field, uniform
        self._light = exitant_light(asset.exitant, asset.frame.half_extents)

    def sample(self, x: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """As `EmitterSampler.sample`; no sampled point is ever hidden."""
        if self._uniform is not None:
            return self._uniform.sample(x, sample), mi.Float(-dr.inf)
        return self._light.sample(x, sample, active), mi.Float(-dr.inf)

    def look(self, entry: Any, direction: Any, active: Any) -> tuple[Any, Any]:
        """As `EmitterSampler.look`."""
        return look(self._asset, self._field, entry, direction, active)

    def eval(
        self,
        x: Any,
        entry: Any,
        direction: Any,
        distance: Any,
        active: Any,
        target: Any = -dr.inf,
        sees: Any = False,
    ) -> tuple[Any, Any, Any]:
        """As `EmitterSampler.eval`."""
        radiance, density = self._eval(x, entry, direction, distance, active)
        if not self._asset.num_leaves:
            return radiance, mi.Float(1), density
        seen, through = self._field.emission(entry, direction, active & sees)
        passed = self._field.transmittance(entry, direction, active & ~mi.Bool(sees))
        return dr.select(sees, seen, radiance), dr.select(sees, through, passed), density

    def pdf(self, x: Any, entry: Any, direction: Any, distance: Any, active: Any = True) -> Any:
        """As `EmitterSampler.pdf`."""
        return self._eval(x, entry, direction, distance, active)[1]

    def _eval(self, x, entry, direction, distance, active):
        radiance, density = self._light.eval(x, entry, direction, distance, active)
        if self._uniform is not None:
            density = self._uniform.pdf(x, direction)
        return radiance, dr.select(active, density, 0)

    def sample_ray(
        self, choice: Any, sample1: Any, sample2: Any, active: Any = True
    ) -> tuple[Any, Any, Any]:
        """As `EmitterSampler.sample_ray`."""
        return self._light.sample_ray(choice, sample1, sample2, active)
