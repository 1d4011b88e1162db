"""Irradiance of patches inside the box of a luminaire, by the light paths that cross them.

Light is traced from the emitters, with all of its vertices. Each of its straight segments adds its
flux to every patch that it crosses, whether it leaves the luminaire or ends on it. The patches are
no surfaces: light goes through them.
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from benchmarks.inside_box.patches import Floats, Rectangle
from lumitree.core.photometry import LUMA
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.lamp.luminaire import Luminaire
from lumitree.trace import light_paths
from lumitree.trace.cameras import PATH_DEPTH, check_finite, is_transmitted
from lumitree.trace.spawning import is_opaque, on_opposite_sides, scene_extent, spawn

# Independent batches that an estimate is the mean of.
BATCHES = 16
# Draw of `Purpose.IRRADIANCE`; lumitree's own uses have smaller ones.
_DRAW = 100
_ROULETTE_DEPTH = 8


def crossing_irradiance(
    luminaire: Luminaire, rectangles: list[Rectangle], num_paths: int, seed: int = 0
) -> list[Floats]:
    """Irradiance of both sides of the patches.

    Args:
        luminaire: without media.
        rectangles: in its local frame.
        num_paths: light paths, rounded up to a multiple of `BATCHES`.
        seed: root seed.

    Returns:
        For each rectangle [B, 2, P, P] independent estimates of its luminance-weighted irradiance,
        radiance times sr.

    Raises:
        LumitreeError: the luminaire has media, or a path's flux is NaN or infinite.
    """
    if luminaire.has_media:
        raise LumitreeError(f"{luminaire.name} has media; give luminaires without media")
    count = -(-num_paths // BATCHES)
    batches: list[list[Floats]] = [[] for _ in rectangles]
    with progress(f"reference of {luminaire.name}", BATCHES) as advance:
        for step in range(BATCHES):
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(SeedStream(Purpose.IRRADIANCE, step, _DRAW).seed(seed), count)
            counter = _Counter(luminaire, rectangles)
            _trace(luminaire, sampler, counter)
            for values, found in zip(batches, counter.irradiance(count), strict=True):
                values.append(found)
            advance(1)
    result = [np.array(values) for values in batches]
    for values in result:
        check_finite(luminaire, values)
    return result


class _Counter:
    """Sums of the flux that crosses the patches."""

    def __init__(self, luminaire: Luminaire, rectangles: list[Rectangle]) -> None:
        self._rectangles = rectangles
        self._half, self._scale = luminaire.frame.half_extents, luminaire.frame.scale
        self._to_local = mi.Transform4f(luminaire.scene_frame.local_from_world)
        dr.make_opaque(self._to_local)
        self._sums = [dr.zeros(mi.Float, 2 * each.patches**2) for each in rectangles]

    def add(self, ray: Any, length: Any, flux: Any, active: Any) -> None:
        """Add the flux (mi.Float) of segments: mi.Ray3f in the scene's frame and their lengths."""
        origin, direction = self._to_local @ ray.o, self._to_local @ ray.d
        for rectangle, sums in zip(self._rectangles, self._sums, strict=True):
            axis = rectangle.axis
            # A part of the length, since the direction's is the local one of a unit of the scene.
            distance = (rectangle.level(self._half) - origin[axis]) / direction[axis]
            crosses = active & (distance > 0) & (distance < length)
            place = origin + distance * direction
            row, column = (
                dr.floor(place[other] / float(step) + rectangle.patches / 2)
                for other, step in zip(rectangle.others, rectangle.steps(self._half), strict=True)
            )
            inside = (dr.minimum(row, column) >= 0) & (dr.maximum(row, column) < rectangle.patches)
            side = dr.select(direction[axis] < 0, mi.UInt32(0), 1)
            index = (side * rectangle.patches + mi.UInt32(row)) * rectangle.patches
            index += mi.UInt32(column)
            dr.scatter_reduce(dr.ReduceOp.Add, sums, flux, index, crosses & inside)

    def irradiance(self, count: int) -> list[Floats]:
        """[2, P, P] of each rectangle, after `count` paths."""
        found = []
        for rectangle, sums in zip(self._rectangles, self._sums, strict=True):
            shape = 2, rectangle.patches, rectangle.patches
            area = count * self._scale**2 * rectangle.steps(self._half).prod()
            found.append(np.array(sums, np.float64).reshape(shape) / area)
        return found


@dr.syntax
def _trace(luminaire: Luminaire, sampler: Any, counter: _Counter) -> None:
    """Trace a light path for each sample of the sampler, as `light_paths.trace_light` does."""
    context = mi.BSDFContext(mi.TransportMode.Importance)
    scene, extent = luminaire.scene, scene_extent(luminaire.scene)
    ray, light = light_paths.emit(luminaire.emitting_surfaces, sampler, extent)[:2]
    flux = mi.Color3f(light)
    depth = mi.UInt32(0)
    active = dr.max(flux) > 0
    while active:
        si = scene.ray_intersect(ray, active)
        grey = dr.dot(flux, mi.Color3f(*LUMA))
        counter.add(ray, dr.select(si.is_valid(), si.t, dr.inf), grey, active)
        active &= si.is_valid()
        bsdf = si.bsdf()
        sample, weight = bsdf.sample(
            context, si, sampler.next_1d(active), sampler.next_2d(active), active
        )
        towards = si.to_world(sample.wo)
        # As in `light_paths`: correction for shading normals, and no light through opaque surfaces.
        cos_in, cos_out = mi.Frame3f.cos_theta(si.wi), mi.Frame3f.cos_theta(sample.wo)
        true_in, true_out = dr.dot(si.n, ray.d), dr.dot(si.n, towards)
        active &= (true_in != 0) & (cos_out != 0)
        crosses = ~is_transmitted(sample.sampled_type) & on_opposite_sides(si, ray.d, towards)
        active &= ~(crosses & is_opaque(bsdf))
        correction = dr.abs(cos_in * true_out / (cos_out * true_in))
        flux = dr.select(active, flux * weight * correction, 0)
        depth += 1
        active &= (depth < PATH_DEPTH) & (dr.max(flux) > 0)
        survival = dr.clip(dr.max(flux) / dr.max(light), 0.05, 1)
        survival = dr.select(depth > _ROULETTE_DEPTH, survival, 1)
        active &= sampler.next_1d(active) < survival
        flux[active] = flux / survival
        ray = dr.select(active, spawn(si, towards, extent), ray)
