"""The rays that an asset emits, sampled by its emission."""

import drjit as dr

from lumitree.asset.asset import Asset
from lumitree.rendering.device import DeviceAsset
from lumitree.trace.light_paths import RayBatch, seeded_sampler


class AssetRays:
    """Rays of an asset, of its light field if it has one; `EmittedRays`."""

    def __init__(self, asset: Asset) -> None:
        self._device = DeviceAsset(asset)

    def draw(self, count: int, seed: int) -> RayBatch:
        """As `EmittedRays.draw`; each sample is a ray."""
        sampler = seeded_sampler(seed, count)
        samples = sampler.next_1d(), sampler.next_2d(), sampler.next_2d()
        origin, direction, flux = self._device.sample_ray(*samples)
        flux /= count
        dr.eval(origin, direction, flux)
        return RayBatch(origin, direction, flux)
