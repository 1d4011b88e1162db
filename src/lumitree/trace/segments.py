"""Segments of light paths that end on the luminaire: the light that does not leave its box.

A segment goes from one vertex of a light path to the next. The last segments of paths that leave
the luminaire are its exitant light; all others end on it. Null interactions, which let light pass
as it is, are no vertices: they neither end a segment nor begin one.

A trace keeps one ending segment of each path. It is chosen with a probability in proportion to its
luminance, by reservoir sampling, and stands for all of the path's.

Symbols
    W   luminance of all ending segments of a path so far
    w   luminance of the one that is kept
"""

import dataclasses
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.frames import LocalFrame
from lumitree.core.photometry import LUMA


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
        origin: mi.Point3f, where each begins, local frame.
        straight: mi.Bool, whether it begins at the emitter.
        direction: mi.Vector3f, direction of travel, local frame.
        flux: mi.Color3f, local units; the sum over the segments of a trace is an estimate of the
            flux of all ending segments of the luminaire's light.
        reach: mi.Float, length, local units.
    """

    origin: Any
    straight: Any
    direction: Any
    flux: Any
    reach: Any


@dataclasses.dataclass
class Reservoir:
    """The ending segment that is kept of each path: a part of the state of a loop.

    Attributes:
        random: mi.PCG32.
        to_local: mi.Transform4f from the scene frame.
        side: mi.Float, cells of the grid a side.
        total: mi.Float, W.
        bent, unlimited: mi.Float, the part of W that is not straight, and this part without a limit
            of the flux.
        luminance: mi.Float, w.
        straight: mi.Bool, of the segment that is kept.
        origin, end: mi.Point3f, of this segment, local frame.
        direction: mi.Vector3f of travel, scene frame.
        flux: mi.Color3f.
    """

    random: Any
    to_local: Any
    side: Any
    total: Any
    bent: Any
    unlimited: Any
    luminance: Any
    straight: Any
    origin: Any
    end: Any
    direction: Any
    flux: Any

    def add(
        self, begin: Any, end: Any, direction: Any, flux: Any, cut: Any, straight: Any, active: Any
    ) -> None:
        """Paths end a segment: replace the one that is kept with probability w / W.

        Args:
            begin, end: mi.Point3f, scene frame.
            direction: mi.Vector3f of travel, scene frame.
            flux: mi.Color3f of the segment.
            cut: mi.Float, flux without a limit over `flux`, see `trace_light`.
            straight: mi.Bool, whether the segment begins at the emitter.
        """
        origin, end = self.to_local @ begin, self.to_local @ end
        leaves_cell = dr.any(grid_cell(origin, self.side) != grid_cell(end, self.side))
        luminance = dr.select(active & leaves_cell, dr.dot(flux, mi.Color3f(LUMA)), 0)
        self.total += luminance
        bent = dr.select(straight, 0, luminance)
        self.bent += bent
        self.unlimited += bent * cut
        replaces = self.random.next_float32() * self.total < luminance
        self.luminance = dr.select(replaces, luminance, self.luminance)
        self.straight = dr.select(replaces, straight, self.straight)
        self.origin = dr.select(replaces, origin, self.origin)
        self.end = dr.select(replaces, end, self.end)
        self.direction = dr.select(replaces, direction, self.direction)
        self.flux = dr.select(replaces, flux, self.flux)

    def segments(self, scale: Any) -> EndingSegments:
        """One segment of each path that has any; their flux is multiplied by `scale`.

        Flux cut off by a limit is given to all that are not straight.
        """
        factor = restoring_factor(self.unlimited, self.bent)
        scale = dr.select(self.straight, scale, scale * factor)
        kept = dr.select(self.luminance > 0, self.flux * (self.total / self.luminance) * scale, 0)
        dr.eval(self.origin, self.end, self.direction, kept)
        # Dr.Jit does not combine an empty array with others, so one without flux is returned.
        chosen = dr.compress(self.luminance > 0)
        if not dr.width(chosen):
            chosen = mi.UInt32([0])
        origin = dr.gather(mi.Point3f, self.origin, chosen)
        direction = self.to_local @ dr.gather(mi.Vector3f, self.direction, chosen)
        segments = EndingSegments(
            origin,
            dr.gather(mi.Bool, self.straight, chosen),
            dr.select(dr.norm(direction) > 0, dr.normalize(direction), mi.Vector3f(0, 0, 1)),
            dr.gather(mi.Color3f, kept, chosen),
            dr.norm(dr.gather(mi.Point3f, self.end, chosen) - origin),
        )
        dr.eval(segments.origin, segments.direction, segments.flux, segments.reach)
        return segments


def restoring_factor(whole: Any, limited: Any) -> Any:
    """Factor (mi.Float) on flux with a limit by which its sum is that without; 1 if there is none.

    Summed by NumPy in double precision: a sum of Dr.Jit depends on the number of threads, and light
    fields are equal by bytes with any number of workers.

    Args:
        whole, limited: mi.Float, flux of each path without and with the limit.
    """
    whole_sum, limited_sum = (
        float(np.array(each).sum(dtype=np.float64)) for each in (whole, limited)
    )
    return dr.opaque(mi.Float, whole_sum / limited_sum if limited_sum > 0 else 1.0)


def make_reservoir(config: EndingConfig, frame: LocalFrame, count: int) -> Reservoir:
    """An empty reservoir of `count` paths; the world of `frame` is the frame of the scene."""
    to_local, side = mi.Transform4f(frame.local_from_world), mi.Float(1 << config.depth)
    dr.make_opaque(to_local, side)
    return Reservoir(
        random=mi.PCG32(count, initstate=dr.opaque(mi.UInt64, config.seed)),
        to_local=to_local,
        side=side,
        total=dr.zeros(mi.Float, count),
        bent=dr.zeros(mi.Float, count),
        unlimited=dr.zeros(mi.Float, count),
        luminance=dr.zeros(mi.Float, count),
        straight=dr.full(mi.Bool, False, count),
        origin=dr.zeros(mi.Point3f, count),
        end=dr.zeros(mi.Point3f, count),
        direction=dr.zeros(mi.Vector3f, count),
        flux=dr.zeros(mi.Color3f, count),
    )


def grid_cell(position: Any, side: Any) -> Any:
    """Cell (mi.Point3i) of a local position in a grid over [-1, 1]³; the nearest, if outside."""
    return dr.clip(mi.Point3i(dr.floor((position + 1) * (side / 2))), 0, mi.Int32(side) - 1)
