"""How much of a luminaire's light its own surfaces leave free, seen straight from its cells.

Symbols
    C, Q, E, K, I, J, s, V      as in `lumitree.asset.light_inside`
    R                           bins a side of the light field, 2 Q
    fine bin                    one of R² bins; four make one of the Q²
"""

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.light_inside import parts_of_ending
from lumitree.asset.lit_bins import by_coarse_bin
from lumitree.core.device import on_device, parameter
from lumitree.core.octahedral import coarse_solid_angles, direction_in_bin, solid_angles
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.fit.light_field.inside import DISTANCES, Entries
from lumitree.lamp.luminaire import Luminaire
from lumitree.octree.leaves import grid_boxes_inside
from lumitree.trace.histograms import distances_passed

# Rays of each fine bin at least, and those that all share by their flux.
_LEAST, _SHARED = 2, 1 << 21
# Rays at once, which bounds the memory.
_CHUNK = 3 << 18
# A ray starts this far beyond its cell, local units, and beyond each null surface that it crosses.
_OFFSET = 1e-4
_MAX_CROSSINGS = 64


def unoccluded(
    luminaire: Luminaire, entries: Entries, seed: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Luminous flux [E, K] of (I + J) V by entry and distance: two independent estimates."""
    fine = _fine_bins(luminaire, entries)
    ends = (_ends(luminaire, entries, fine, (seed, part)) for part in (0, 1))
    # Sums of what ends at a distance or farther.
    first, second = (each[:, ::-1].cumsum(axis=1, dtype=np.float32)[:, ::-1] for each in ends)
    return first, second


@dataclasses.dataclass(frozen=True)
class _FineBins:
    """Fine bins [M] that emit, in the order of their entries.

    Attributes:
        flux: luminous flux of I + J.
        bin: mi.UInt32, its index.
        corners: two mi.Point3f, of its cell, local units.
    """

    entry: NDArray[np.integer]
    flux: NDArray[np.floating]
    bin: Any
    corners: tuple[Any, Any]


def _fine_bins(luminaire: Luminaire, entries: Entries) -> _FineBins:
    solid_angle = solid_angles(entries.resolution)
    members = by_coarse_bin(np.arange(entries.resolution**2)[None])[0][entries.bins]
    leaving = entries.exits[entries.rows[:, None], members]
    coarse = coarse_solid_angles(entries.resolution)[entries.bins]
    ending = entries.beyond[:, 0] / coarse
    parts = parts_of_ending(leaving, ending, solid_angle[members])
    flux = ((leaving + parts * ending[:, None]) * solid_angle[members]).ravel()
    bins, entry = members.ravel(), np.repeat(np.arange(len(entries.bins)), 4)
    emits = flux > 0
    bins, entry, flux = bins[emits], entry[emits], flux[emits]
    low, high = grid_boxes_inside(luminaire.frame.half_extents, entries.cells, entries.depth)
    cell = entries.rows[entry]
    corners = on_device(mi.Point3f, low[cell]), on_device(mi.Point3f, high[cell])
    return _FineBins(entry, flux, on_device(mi.UInt32, bins), corners)


def _ends(
    luminaire: Luminaire, entries: Entries, fine: _FineBins, seed: tuple[int, int]
) -> NDArray[np.float32]:
    """Luminous flux [E, K] of (I + J) V that gets as far as a distance and no farther.

    A curve is a ratio, so that noise makes it too large. It must be low in bright bins, which may
    have a curve of their own.
    """
    root, part = seed
    rays = _LEAST + (fine.flux / max(fine.flux.sum(), 1e-30) * _SHARED).astype(np.int64)
    every, weight = np.repeat(np.arange(len(rays)), rays), fine.flux / rays
    ends = np.zeros((len(entries.bins), len(DISTANCES)), np.float32)
    for step, start in enumerate(range(0, len(every), _CHUNK)):
        of = every[start : start + _CHUNK]
        stream = SeedStream(Purpose.VISIBILITY, step).seed(root, part)
        found = _first_hits(luminaire, fine, of, entries.resolution, stream)
        first, last = fine.entry[of[0]], fine.entry[of[-1]]
        rows = last + 1 - first
        index = (fine.entry[of] - first) * len(DISTANCES) + found
        sums = np.bincount(index, weight[of], rows * len(DISTANCES))
        ends[first : last + 1] += sums.reshape(rows, -1)
    return ends


def _first_hits(
    luminaire: Luminaire, fine: _FineBins, of: NDArray[np.integer], resolution: int, seed: int
) -> NDArray[np.uint32]:
    """Index [N] in `DISTANCES` of the last distance before what rays of the fine bins `of` [N] hit.

    They start anywhere in their cells, which they leave without a hit.
    """
    random = mi.PCG32(len(of), initstate=dr.opaque(mi.UInt64, seed))
    index = on_device(mi.UInt32, of)
    direction, _ = direction_in_bin(
        dr.gather(mi.UInt32, fine.bin, index),
        mi.Point2f(random.next_float32(), random.next_float32()),
        resolution,
    )
    lower, upper = (dr.gather(mi.Point3f, each, index) for each in fine.corners)
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
    return np.array(distances_passed(distance, DISTANCES))


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
        # Not the mean: its divisor would be a constant that depends on the number of rays.
        passed = dr.sum(bsdf.eval_null_transmission(si, active)) / 3
        active &= random.next_float32() < passed
        step = dr.select(active, _OFFSET * scale, 0)
        length += step
        ray.o = dr.select(active, ray(hit.t + step), ray.o)
        crossings += 1
    return length
