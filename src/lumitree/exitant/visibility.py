"""How much of a luminaire's light its own surfaces leave free, seen straight from its cells.

Symbols
    C, Q, E, K, I, J, s, V      as in `lumitree.asset.light_inside`
    R                           bins a side of the exitant light field, 2 Q
    fine bin                    one of R² bins; four make one of the Q²
"""

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter
from lumitree.core.octahedral import direction_in_bin, solid_angles
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.exitant.inside import DISTANCES, Entries, by_coarse_bin
from lumitree.luminaire.luminaire import Luminaire
from lumitree.octree.leaves import grid_boxes_inside

# Rays of each fine bin for two independent estimates, and fine bins at once, which bounds the
# memory.
_RAYS = 3, 3
_CHUNK = 1 << 17
# A ray starts this far beyond its cell, local units, and beyond each null surface that it crosses.
_OFFSET = 1e-4
_MAX_CROSSINGS = 64


def unoccluded(
    luminaire: Luminaire, entries: Entries, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Luminous flux [E, K] of (I + J) V by entry and distance: two independent estimates.

    Args:
        luminaire: whose surfaces block light.
        entries: bins with light.
        seed: root seed.
    """
    fine_solid_angles = solid_angles(entries.resolution)
    # Fine bins that emit, by entry. Light that ends does so in all four.
    members = by_coarse_bin(np.arange(entries.resolution**2).reshape(1, -1))[0]
    bins, entry = members[entries.bins].ravel(), np.repeat(np.arange(len(entries.bins)), 4)
    cell = entries.rows[entry]
    leaving = entries.exits[cell, bins]
    emits = (leaving > 0) | (entries.beyond[entry, 0] > 0)
    bins, entry, cell = bins[emits], entry[emits], cell[emits]
    solid_angle = fine_solid_angles[bins].astype(np.float32)
    leaving = leaving[emits] * solid_angle
    low, high = grid_boxes_inside(luminaire.frame.half_extents, entries.cells, entries.depth)

    shape = len(_RAYS), len(entries.bins), len(DISTANCES)
    # Flux of I, and solid angle, of rays that are free as far as a distance and no farther.
    exit_hits, end_hits = np.zeros(shape, np.float32), np.zeros(shape, np.float32)
    for step, start in enumerate(range(0, len(bins), _CHUNK)):
        part = slice(start, start + _CHUNK)
        rays = SeedStream(Purpose.VISIBILITY, step).seed(seed)
        found = _first_hits(
            luminaire, low[cell[part]], high[cell[part]], bins[part], entries.resolution, rays
        )
        first, last = entry[part][0], entry[part][-1]
        rows = last + 1 - first
        index = (entry[part] - first)[:, None] * shape[2] + found
        estimates = np.split(index, np.cumsum(_RAYS)[:-1], axis=1)
        for hits, weight in ((exit_hits, leaving), (end_hits, solid_angle)):
            for estimate, each in zip(hits, estimates, strict=True):
                weights = np.repeat(weight[part] / each.shape[1], each.shape[1])
                sums = np.bincount(each.ravel(), weights, rows * shape[2])
                estimate[first : last + 1] += sums.reshape(rows, -1)
    solid_angle = solid_angles(entries.resolution // 2)[entries.bins].astype(np.float32)
    ending = (entries.beyond[:, :1] / solid_angle[:, None]).astype(np.float32)
    first, second = (
        (_beyond(exits) + ending * _beyond(ends)).astype(np.float32, copy=False)
        for exits, ends in zip(exit_hits, end_hits, strict=True)
    )
    return first, second


def _beyond(hits: NDArray[np.float32]) -> NDArray[np.float32]:
    """Sums [E, K] of what ends at a distance or farther."""
    return hits[:, ::-1].cumsum(axis=1, dtype=np.float32)[:, ::-1]


def _first_hits(
    luminaire: Luminaire,
    low: NDArray[np.floating],
    high: NDArray[np.floating],
    bins: NDArray[np.integer],
    resolution: int,
    seed: int,
) -> NDArray[np.uint32]:
    """The last distance before what rays of M fine bins hit.

    They start anywhere in boxes from `low` to `high` [M, 3], which they leave without a hit.

    Returns:
        [M, rays of each] index in `DISTANCES`.
    """
    count = sum(_RAYS)
    lower, upper = on_device(mi.Point3f, low), on_device(mi.Point3f, high)
    index = dr.arange(mi.UInt32, len(bins) * count)
    random = mi.PCG32(len(bins) * count, initstate=dr.opaque(mi.UInt64, seed))
    fine = index // count
    direction, _ = direction_in_bin(
        dr.gather(mi.UInt32, on_device(mi.UInt32, bins), fine),
        mi.Point2f(random.next_float32(), random.next_float32()),
        resolution,
    )
    lower, upper = dr.gather(mi.Point3f, lower, fine), dr.gather(mi.Point3f, upper, fine)
    sample = mi.Point3f(random.next_float32(), random.next_float32(), random.next_float32())
    origin = dr.lerp(lower, upper, sample)
    leaves = dr.min(dr.maximum((lower - origin) / direction, (upper - origin) / direction))
    frame = luminaire.scene_frame
    to_scene = mi.Transform4f(frame.world_from_local)
    dr.make_opaque(to_scene)
    scale = parameter(mi.Float, frame.scale)
    ray = mi.Ray3f(
        to_scene @ mi.Point3f(origin + (leaves + _OFFSET) * direction),
        to_scene @ mi.Vector3f(direction) / scale,
    )
    distance = leaves + _free_length(luminaire.scene, ray, random, scale) / scale
    passed = mi.UInt32(0)
    for each in DISTANCES[1:].tolist():
        passed += dr.select(distance >= each, mi.UInt32(1), mi.UInt32(0))
    return np.array(passed).reshape(-1, count)


@dr.syntax
def _free_length(scene, ray, random, scale):
    """Length (mi.Float) of rays before the first surface that blocks them, scene units."""
    ray = mi.Ray3f(ray)
    length = mi.Float(0)
    crossings = mi.UInt32(0)
    active = mi.Bool(True)
    while active:
        hit = scene.ray_intersect_preliminary(ray, coherent=False, active=active)
        length += dr.select(active, hit.t, 0)
        active &= hit.is_valid() & (crossings < _MAX_CROSSINGS)
        bsdf = hit.shape.bsdf()
        active &= mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null)
        si = hit.compute_surface_interaction(ray, mi.RayFlags.All, active)
        active &= random.next_float32() < dr.mean(bsdf.eval_null_transmission(si, active))
        step = dr.select(active, _OFFSET * scale, 0)
        length += step
        ray.o = dr.select(active, ray(hit.t + step), ray.o)
        crossings += 1
    return length
