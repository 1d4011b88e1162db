"""The flux correction factor: total flux of the luminaire over the field's total flux."""

from collections.abc import Callable
from typing import Any, NamedTuple

import drjit as dr
import mitsuba as mi

from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.octree.config import FluxConfig
from lumitree.fit.octree.leaf_field import LeafField
from lumitree.fit.octree.ray_source import RaySource


class FluxCorrection(NamedTuple):
    """Factor on L_max that gives the field the total flux of the source; 1 where either is 0.

    `beyond` is the part of the source's flux that is radiance above L_max, which no field has.
    """

    factor: float
    beyond: float


def flux_correction(
    field: LeafField,
    source: RaySource,
    max_radiance: float,
    config: FluxConfig,
    step: int,
    over: Callable[[], bool] | None = None,
) -> FluxCorrection:
    """The flux correction of a field with L_max `max_radiance`, made by `step` steps of descent.

    No second draw is made once `over` returns true; with fewer draws the factor is less precise.
    """
    traced, shown, beyond = 0.0, 0.0, 0.0
    for draw in range(config.draws):
        if draw and over is not None and over():
            break
        stream = SeedStream(Purpose.FLUX_CORRECTION, step, draw)
        rays = source.draw(config.rays, stream, _all_rays, config.light_paths_per_ray)
        radiance, _, _ = field.integrate(rays.origin, rays.direction)
        traced += float(dr.sum(rays.light, axis=None)[0]) / max_radiance
        shown += float(dr.sum(rays.share * radiance, axis=None)[0])
        # Light paths, whose share is 0, bring light of no known radiance.
        above = rays.light / max_radiance - rays.share
        seen = dr.select(rays.share > 0, dr.maximum(above, 0), 0)
        beyond += float(dr.sum(seen, axis=None)[0])
    factor = traced / shown if traced > 0 and shown > 0 else 1.0
    return FluxCorrection(factor, beyond / traced if traced > 0 else 0.0)


def _all_rays(origin: Any, direction: Any) -> Any:
    return dr.full(mi.Bool, True, dr.width(origin))
