"""The light field of an asset that has a radiance field only: of the field's own rays."""

import dataclasses

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import make_light_field
from lumitree.core.backend import load_mitsuba
from lumitree.core.device import as_rows
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream

# Grid and bins of direction a side, as of a bake; batches, and rays of each.
_DEPTH, _RESOLUTION = 5, 32
_BATCHES, _BATCH = 4, 1 << 20


def with_field_light(asset: Asset) -> Asset:
    """The asset with a light field, which illuminates scenes; as it is if it has one.

    It is made of rays that leave the radiance field, with equal random numbers for equal fields.
    Nothing is added if the field emits no light.
    """
    if asset.light_field is not None or not asset.num_leaves:
        return asset
    load_mitsuba()
    from lumitree.core.octahedral import intensity_of_histogram
    from lumitree.rendering.asset_flux import AssetRays
    from lumitree.trace.histograms import Histogram

    rays, histogram = AssetRays(asset.without_factors), Histogram(_DEPTH, _RESOLUTION)
    with progress("light", _BATCHES) as advance:
        for batch in range(_BATCHES):
            drawn = rays.draw(_BATCH, SeedStream(Purpose.FIELD_RAYS, batch).seed(0))
            histogram.add(drawn.origin, drawn.direction, as_rows(drawn.flux).T / _BATCHES)
            advance(1)
    if not histogram.flux.any():
        return asset
    intensity = intensity_of_histogram(histogram.flux)
    field = make_light_field(histogram.cells, intensity, _DEPTH)
    return dataclasses.replace(asset, light_field=field)
