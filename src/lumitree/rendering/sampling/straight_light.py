"""Straight light: points of a lamp's own emitters, whose light reaches a receiver without a vertex.

The light field says where to look: emitters are sampled by the straight light that it has of them
in the direction of the receiver. The geometry, which is in the scene, says what is there: a shadow
ray decides whether the light arrives.

Elements that are near each other are a cluster. A cluster is sampled first, and then an element of
it by what it sends in a direction, so that few samples are on a side that is turned away.

Symbols
    E   elements, in the order of their clusters        K   clusters
    R   bins of direction a side of the light field     B   bins of direction for elements
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.spatial import KDTree

from lumitree.asset.light_field import LightField, unpack
from lumitree.core.alias_table import AliasTable
from lumitree.core.device import on_device, parameter
from lumitree.core.octahedral import bin_of, middle_directions
from lumitree.octree.build import morton
from lumitree.rendering.sampling.cell_table import cell_rows
from lumitree.rendering.sampling.emitter_sampling import STRAIGHT, Target
from lumitree.rendering.sampling.emitting_elements import Elements, EmittingSurface
from lumitree.rendering.sampling.light_bins import smooth_bin
from lumitree.rendering.sampling.receiver_cells import ReceiverCells
from lumitree.rendering.sampling.samples import resample, scrambled

# Clusters at most, the depth of the finest grid whose cells they are, and how many are candidates.
_CLUSTERS, _DEPTH, _CANDIDATES = 16, 5, 2
# Part of what emitters would send if nothing were in the way that is straight light at least: paths
# may have missed some. A part of its mean over all directions is added to it.
_MISSED, _ANYWHERE = 0.02, 0.2
# Cells of receivers, see `receiver_cells`.
_RECEIVERS = (16, 4, 0.3)
# Bins of direction a side, and entries of the table of elements by direction: lamps with more
# elements have fewer bins.
_BINS, _MAX_ENTRIES = 16, 1 << 21
# Parts of the mean radiance of its surface that is added to that of an element, since bright spots
# may lie between its points; and of what an element sends on the average over the sphere that is
# added in all directions, since receivers see the elements of a cluster from other directions.
_FLOOR, _SPREAD = 0.2, 0.05


class StraightLight:
    """The emitters of a lamp.

    Args:
        surfaces: that emit, at least one.
        field: light field of the lamp; None if there is none.
        half_extents: of the lamp's box.
        gain: [3] factors on R, G and B.

    Attributes:
        densities: [N] of the surfaces: density per local area that stands for that of their points
            in weights of multiple importance sampling.
    """

    def __init__(
        self,
        surfaces: Sequence[EmittingSurface],
        field: LightField | None,
        half_extents: NDArray[np.float64],
        gain: tuple[float, float, float],
    ) -> None:
        self._elements, self._gain = Elements(surfaces), parameter(mi.Color3f, *gain)
        each, area = self._elements, self._elements.area
        self.densities = each.densities
        light = area[:, None] * (each.radiance + _FLOOR * each.surface_radiance[each.surface])
        weight = light.mean(axis=1)
        # Black ones have a direction, too.
        weight = np.maximum(weight, 1e-9 * weight.max() or 1.0)
        cluster, order = _clusters(each.middle)
        first = np.searchsorted(cluster[order], np.arange(cluster.max() + 2))
        each.sort(order)
        self._first, self._bins = on_device(mi.UInt32, first[:-1]), _BINS
        while self._bins > 1 and self._bins**2 * len(area) > _MAX_ENTRIES:
            self._bins //= 2
        sent = weight * (np.maximum(middle_directions(self._bins) @ each.normal.T, 0) + _SPREAD / 4)
        rows = np.split(sent[:, order], first[1:-1], axis=1)
        # A part for each cluster, with a row for each bin of direction.
        self._entries = AliasTable(rows, *(each.shape for each in rows))

        flux = np.asarray(np.bincount(cluster, weight), np.float64)
        middles = np.stack([np.bincount(cluster, weight * x) for x in each.middle.T], axis=1)
        middles /= flux[:, None]
        low, high = (
            np.stack([f(x[order], first[:-1]) for x in each.middle.T], axis=1)
            for f in (np.minimum.reduceat, np.maximum.reduceat)
        )
        corners = on_device(mi.Float, np.stack([low, high], axis=1))
        size = ((high - low) ** 2).sum(axis=1) / 4
        self._middles = on_device(mi.Float, np.concatenate([middles, size[:, None]], axis=1))
        self._resolution = 8 if field is None else field.resolution
        bare = _bare(cluster, light @ np.array(gain), each.normal, self._resolution)
        seen = bare
        if field is not None:
            # Of what is hidden in part, the root mean square of samples, and not their mean.
            straight = _straight(field, middles, gain)
            seen = np.sqrt(np.maximum(straight, _MISSED * bare) * bare)
        # What receivers outside the box get of clusters, and others.
        self._intensity = on_device(mi.Float, np.stack([seen, bare]))
        self._clusters = parameter(mi.UInt32, len(flux))
        self._around = ReceiverCells(half_extents, *_RECEIVERS)
        scale = parameter(mi.Float, max(float(seen.max()), 1e-30))
        rows = cell_rows(self._around, corners, self._towards, scale, flux)
        self._table = AliasTable(rows, (self._around.count + 1, len(flux)))

    def _offset(self, x, cluster, active):
        """From the middle of a cluster to a receiver, and half its diagonal in square."""
        middle = dr.gather(mi.Vector4f, self._middles, cluster, active)
        return mi.Vector3f(x - mi.Point3f(middle.x, middle.y, middle.z)), middle.w

    def _towards(self, cluster, offset, _distance):
        """What a cluster sends to receivers outside the box, in the direction of a mi.Vector3f."""
        return mi.Color3f(self._sent(cluster, offset, mi.Bool(False), mi.Bool(True)))

    def _sent(self, cluster, offset, inside, active):
        """Radiant intensity of a cluster towards a receiver, about, summed over the channels."""
        index = dr.select(inside, self._clusters, 0) + cluster
        index = index * self._resolution**2 + smooth_bin(offset, self._resolution)
        return dr.gather(mi.Float, self._intensity, index, active)

    def choose(
        self, x: mi.Point3f, sample: mi.Point2f, target: Target, active: mi.Bool, inside: mi.Bool
    ) -> None:
        """Let a target be one of straight light, with the probability of its part of the light.

        Resampled importance sampling, as `DeviceLightField.sample_point`. Its clusters and the
        points of stored light are candidates alike.

        Args:
            x: receiver, anywhere.
            sample: in the unit square, as for the target.
            target: of stored light; changed. A `total` of 0 for straight light alone.
            inside: receivers in the box.
        """
        random = scrambled(mi.Point2f(1 - sample.x, sample.y))
        choice = random.y
        row = dr.select(inside, self._around.count, self._around.index(x))
        total, chosen = mi.Float(0), mi.Float(0)
        found, found_pmf = mi.UInt32(0), mi.Float(1)
        for candidate in range(_CANDIDATES):
            place = random.x + candidate / _CANDIDATES
            place = dr.select(place < 1, place, place - 1)
            cluster, pmf = self._table.sample(row, place, active)
            offset, size = self._offset(x, cluster, active)
            light = self._sent(cluster, offset, inside, active)
            light /= pmf * (dr.squared_norm(offset) + size)
            total += light
            taken, choice = resample(choice, light, total)
            chosen = dr.select(taken, light, chosen)
            found = dr.select(taken, cluster, found)
            found_pmf = dr.select(taken, pmf, found_pmf)
        total = dr.select(active, total / _CANDIDATES, 0)
        part = dr.select(total > 0, total / (total + target.total), 0)
        straight = random.z < part
        stored = target.factor / (1 - part)
        target.factor = dr.select(straight, total / (chosen * part), stored)
        target.cell = dr.select(straight, found, target.cell)
        target.pmf = dr.select(straight, found_pmf, target.pmf)
        target.place = dr.select(straight, mi.UInt32(STRAIGHT), target.place)

    def sample(
        self, x: mi.Point3f, target: Target, sample: mi.Point2f, active: mi.Bool
    ) -> mi.Vector3f:
        """Direction to a point of the cluster of a target, which gets the light of the point.

        Args:
            x: receiver, anywhere.
            sample: in the unit square, as for the target.
        """
        random = scrambled(mi.Point2f(sample.x, 1 - sample.y))
        place, cluster = mi.Point2f(random.y, random.z), dr.select(active, target.cell, 0)
        offset, _ = self._offset(x, cluster, active)
        bins = bin_of(offset, self._bins, bevelled=False)
        entry, chance = self._entries.sample(bins, random.x, active, cluster)
        entry += dr.gather(mi.UInt32, self._first, cluster, active)
        found = self._elements.point(entry, place, active)
        offset = mi.Vector3f(found.p - x)
        squared = dr.squared_norm(offset)
        per_area = dr.abs(dr.dot(found.n, offset)) * dr.rsqrt(squared) / squared
        front = active & (dr.dot(found.facing, offset) < 0) & (per_area > 0)
        # Radiance over the density per steradian with which the point is sampled.
        light = self._gain * found.radiance * (per_area * found.area / chance)
        target.light = dr.select(front, light * (target.factor / target.pmf), 0)
        target.density = dr.select(front, found.density / per_area, 0)
        distance = dr.sqrt(squared)
        target.distance = dr.select(active, distance, target.distance)
        return offset / distance


def _clusters(middle: NDArray[np.float64]) -> tuple[NDArray[np.int64], NDArray[np.int64]]:
    """Cluster of each element by its middle [E, 3], and the order of elements by clusters."""
    depth = _DEPTH
    while True:
        side = 1 << depth
        cell = np.clip(np.floor((middle + 1) * (side / 2)), 0, side - 1).astype(np.int64)
        codes, cluster = np.unique(morton(cell), return_inverse=True)
        if len(codes) <= _CLUSTERS:
            return cluster, np.argsort(cluster, kind="stable")
        depth -= 1


def _bare(
    cluster: NDArray[np.int64],
    light: NDArray[np.float64],
    normal: NDArray[np.float64],
    resolution: int,
) -> NDArray[np.float64]:
    """Radiant intensity [K, R²] of clusters in bins of direction if nothing were in the way.

    A part of it is the same in all directions.

    Args:
        light: [E] area times radiance of elements.
    """
    count = _BINS**2
    facing = np.array(bin_of(on_device(mi.Vector3f, normal), _BINS, bevelled=False), np.int64)
    by_normal = np.bincount(cluster * count + facing, light, (cluster.max() + 1) * count)
    by_normal = by_normal.reshape(-1, count)
    towards = np.maximum(middle_directions(_BINS) @ middle_directions(resolution).T, 0)
    return by_normal @ (towards + _ANYWHERE / 4)


def _straight(
    field: LightField, middles: NDArray[np.float64], gain: tuple[float, float, float]
) -> NDArray[np.float64]:
    """Straight radiant intensity [K, R²] of clusters in a light field; `middles` [K, 3] of them."""
    straight = field.scale * (unpack(field.intensity) - unpack(field.bent)) @ np.array(gain)
    by_cell = field.dense(straight)
    centres = (field.cells + 0.5) * (2 / (1 << field.depth)) - 1
    nearest = KDTree(middles).query(centres)[1]
    return np.stack([by_cell[nearest == i].sum(axis=0) for i in range(len(middles))])
