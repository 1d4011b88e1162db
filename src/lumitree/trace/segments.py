"""Segments of light paths that end on the luminaire: the light that does not leave its box.

A segment goes from one vertex of a light path to the next. The last segments of paths that leave
the luminaire are its exitant light; all others end on it. Null interactions, which let light pass
as it is, are no vertices: they neither end a segment nor begin one.

A trace keeps one ending segment of each path. It is chosen with a probability in proportion to its
luminance, by reservoir sampling, and stands for all segments of the path.

Symbols
    W   luminance of all ending segments of a path so far
    w   luminance of the segment that is kept
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import parameter, random_numbers
from lumitree.core.frames import LocalFrame
from lumitree.core.octahedral import bin_of, coarse_bin
from lumitree.core.photometry import LUMA
from lumitree.trace.histograms import BinnedSegments, grid_cell, with_bins


@dataclasses.dataclass(frozen=True)
class EndingConfig:
    """Which ending segments a trace returns.

    Attributes:
        depth: those that end in another cell than they start in, of a grid of 2**depth cells a
            side over the cube [-1, 1]³ of the local frame.
        seed: of the random numbers that choose one segment of each path.
    """

    depth: int
    seed: int


@dataclasses.dataclass
class EndingSegments:
    """Segments of light paths that end on the luminaire.

    Attributes:
        origin: where each begins, local frame.
        straight: whether it begins at the emitter.
        direction: direction of travel, local frame.
        flux: local units; the sum over the segments of a trace is an estimate of the flux of all
            ending segments of the luminaire's light.
        reach: length, local units.
    """

    origin: mi.Point3f
    straight: mi.Bool
    direction: mi.Vector3f
    flux: mi.Color3f
    reach: mi.Float


@dataclasses.dataclass
class _Segment:
    """A segment with its w; its ends in the local frame, its direction in the scene frame."""

    luminance: mi.Float
    straight: mi.Bool
    origin: mi.Point3f
    end: mi.Point3f
    direction: mi.Vector3f
    flux: mi.Color3f


@dataclasses.dataclass
class Reservoir:
    """The ending segment that is kept of each path: a part of the state of a loop.

    Attributes:
        random: generator that chooses.
        to_local: from the scene frame.
        side: cells of the grid a side.
        total: W.
        bent, unlimited: the part of W that is not straight, and this part without a limit of the
            flux.
        kept: the segment.
    """

    random: mi.PCG32
    to_local: mi.Transform4f
    side: mi.Float
    total: mi.Float
    bent: mi.Float
    unlimited: mi.Float
    kept: _Segment

    @staticmethod
    def empty(config: EndingConfig, frame: LocalFrame, count: int) -> Reservoir:
        """The reservoir of `count` paths; the world of `frame` is the frame of the scene."""
        to_local, side = mi.Transform4f(frame.local_from_world), mi.Float(1 << config.depth)
        dr.make_opaque(to_local, side)
        random = random_numbers(count, config.seed)
        total, bent, unlimited = (dr.zeros(mi.Float, count) for _ in range(3))
        kept = dr.zeros(_Segment, count)
        return Reservoir(random, to_local, side, total, bent, unlimited, kept)

    def add(
        self,
        begin: mi.Point3f,
        end: mi.Point3f,
        direction: mi.Vector3f,
        flux: mi.Color3f,
        cut: mi.Float,
        straight: mi.Bool,
        active: mi.Bool,
    ) -> None:
        """Paths end a segment: replace the one that is kept with probability w / W.

        Args:
            begin, end: scene frame.
            direction: of travel, scene frame.
            flux: of the segment.
            cut: flux without a limit over `flux`, see `trace_light`.
            straight: whether the segment begins at the emitter.
        """
        origin, end = self.to_local @ begin, self.to_local @ end
        leaves_cell = dr.any(grid_cell(origin, self.side) != grid_cell(end, self.side))
        luminance = dr.select(active & leaves_cell, dr.dot(flux, mi.Color3f(LUMA)), 0)
        self.total += luminance
        bent = dr.select(straight, 0, luminance)
        self.bent += bent
        self.unlimited += bent * cut
        replaces = self.random.next_float32() * self.total < luminance
        segment = _Segment(luminance, straight, origin, end, direction, flux)
        self.kept = dr.select(replaces, segment, self.kept)

    def segments(self, scale: mi.Float) -> EndingSegments:
        """One segment of each path that has any; their flux is multiplied by `scale`.

        Flux cut off by a limit is given to all that are not straight.
        """
        kept = self.kept
        factor = restoring_factor(self.unlimited, self.bent)
        scale = dr.select(kept.straight, scale, scale * factor)
        ends = kept.luminance > 0
        kept.flux = dr.select(ends, kept.flux * (self.total / kept.luminance) * scale, 0)
        dr.eval(kept)
        # Dr.Jit does not combine an empty array with others, so one without flux is returned.
        chosen = dr.compress(ends)
        if not dr.width(chosen):
            chosen = mi.UInt32([0])
        kept = dr.gather(_Segment, kept, chosen)
        direction = self.to_local @ kept.direction
        direction = dr.select(dr.norm(direction) > 0, dr.normalize(direction), mi.Vector3f(0, 0, 1))
        reach = dr.norm(kept.end - kept.origin)
        segments = EndingSegments(kept.origin, kept.straight, direction, kept.flux, reach)
        dr.eval(segments)
        return segments


def restoring_factor(whole: mi.Float, limited: mi.Float) -> mi.Float:
    """Factor on flux with a limit by which its sum is the sum without; 1 if it is 0.

    Summed by NumPy in double precision: a sum of Dr.Jit depends on the number of threads, and light
    fields are equal by bytes with any number of workers.

    Args:
        whole, limited: flux of each path without and with the limit.
    """
    whole_sum, limited_sum = (
        float(np.array(each).sum(dtype=np.float64)) for each in (whole, limited)
    )
    return parameter(mi.Float, whole_sum / limited_sum if limited_sum > 0 else 1.0)


def bin_segments(
    segments: EndingSegments,
    flux: NDArray[np.floating],
    depth: int,
    resolution: int,
    distances: NDArray[np.float32],
    seed: int,
) -> BinnedSegments:
    """Segments with a flux [3, N] in a grid of 2**depth cells and Q bins of direction a side.

    Args:
        distances: see `BinnedSegments`.
        seed: of where in its cell each reach begins.
    """
    # Light starts anywhere in its cell, and so its reach is from there on.
    side = 2 / (1 << depth)
    random = random_numbers(flux.shape[1], seed)
    start = mi.Vector3f(random.next_float32(), random.next_float32(), random.next_float32())
    within = (mi.Vector3f(segments.origin) + 1) / side
    moved = (within - dr.floor(within) - start) * side
    steps = np.array(
        distances_passed(segments.reach + dr.dot(moved, segments.direction), distances)
    )
    bins = coarse_bin(bin_of(segments.direction, 2 * resolution), 2 * resolution)
    rays = with_bins(segments.origin, bins, segments.straight, flux, depth)
    return BinnedSegments(rays, np.minimum(steps, len(distances) - 2).astype(np.uint8))


def distances_passed(length: mi.Float, distances: NDArray[np.float32]) -> mi.UInt32:
    """How many of some distances after the first are at most a length."""
    passed = mi.UInt32(0)
    for each in distances[1:].tolist():
        passed += dr.select(length >= each, mi.UInt32(1), mi.UInt32(0))
    return passed
