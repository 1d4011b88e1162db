"""The rays that an asset emits, sampled as next-event estimation samples its emission."""

import drjit as dr

from lumitree.asset.asset import Asset
from lumitree.octree.field import shared_field
from lumitree.rendering.sampling.divided_sampling import emitter_sampler
from lumitree.rendering.sampling.emitted_light import emitted_light
from lumitree.rendering.sampling.proxy import BoxProxy
from lumitree.trace.light_paths import RayBatch, seeded_sampler


class AssetRays:
    """Rays of an asset, of its light field if it has one; `EmittedRays`."""

    def __init__(self, asset: Asset) -> None:
        # Not `emitter_sampler` of both: it makes the tables of receivers too.
        if asset.light_field is not None:
            self._emitter = emitted_light(asset)
        else:
            box = BoxProxy(asset.frame.half_extents)
            self._emitter = emitter_sampler(asset, shared_field(asset), box)

    def draw(self, count: int, seed: int) -> RayBatch:
        """As `EmittedRays.draw`; each sample is a ray."""
        sampler = seeded_sampler(seed, count)
        samples = sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
        origin, direction, flux = self._emitter.sample_ray(*samples)
        flux /= count
        dr.eval(origin, direction, flux)
        return RayBatch(origin, direction, flux)
