"""Which lamp next-event estimation samples: by what each sends to the receiver.

Lamps are the leaves of a tree. A node is chosen among its siblings in proportion to an estimate of
the irradiance that its lamps send to the receiver, so a sample visits about √N nodes of each level.

Symbols
    N       lamps               L       levels of the tree, the least with 32^L ≥ N
    k       children of a node, the least with k^L ≥ N
    x, n    receiver and its normal, 0 where light may come from all sides
    c, r    centre and radius of a sphere around all boxes of a node's lamps
    d, ω    distance from c to x, and direction from c to x
    I       luminous intensity of a node towards ω: Σ ω_a² I_a over the three of the six axis
            directions a that ω is on the side of
    w       I cos θ' / max(d², r²/4), the estimate. cos θ' = (cos θ + s) / (1 + s), at least 0, with
            the angle θ between n and -ω and with s = min(r/d, 1); it is 0 only where the whole
            sphere is below the receiver's horizon

A tree of few levels with many children is closer to proportional than a binary one, in which the
errors of each level multiply, and evaluates about as many nodes.
"""

from __future__ import annotations

import dataclasses

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device, parameter

# What stands for no lamp.
NO_LAMP = 0xFFFFFFFF
# Children of a node at most.
_MAX_CHILDREN = 32
# Part of a node's intensity that is the same in all directions: a direction from the centre of a
# node is not that from each of its lamps.
_EVEN_PART = 0.1
# Least cos θ' within the sphere of a node, whose lamps may be on any side.
_LEAST_COSINE = 0.25
# Added to s, so that rounding does not bring a lamp below the horizon.
_SLACK = 1e-3
# Numbers of a node on the device: centre and radius; intensities towards +x, +y, +z; towards
# -x, -y, -z.
_PACKETS = 3


@dataclasses.dataclass(frozen=True, eq=False)
class Lamps:
    """Lamps among which one is chosen.

    Attributes:
        centres: [N, 3], scene.
        radii: [N] of spheres around their boxes.
        intensities: [N, 6] luminous intensity towards +x, +y, +z, -x, -y and -z of the scene,
            smoothed; any unit.
    """

    centres: NDArray[np.float64]
    radii: NDArray[np.float64]
    intensities: NDArray[np.float64]

    def __len__(self) -> int:
        return len(self.radii)


def tree_shape(count: int) -> tuple[int, int]:
    """Levels L and children k of the tree of a number of lamps."""
    levels = 1
    while _MAX_CHILDREN**levels < count:
        levels += 1
    children = 1
    while children**levels < count:
        children += 1
    return levels, children


def make_nodes(lamps: Lamps) -> tuple[NDArray[np.float64], NDArray[np.int64]]:
    """The tree as rows: the children of row i begin at row k (i + 1), the root's at row 0.

    Returns:
        [rows, 12], numbers of a node as `_PACKETS` has them, 0 for nodes without lamps; and row [N]
        of each lamp.
    """
    levels, children = tree_shape(len(lamps))
    rows = np.zeros((sum(children ** (level + 1) for level in range(levels)), 4 * _PACKETS))
    row_of = np.zeros(len(lamps), np.int64)
    pending = [(-1, 0, np.arange(len(lamps)))]
    while pending:
        parent, level, members = pending.pop()
        for i, part in enumerate(_divide(lamps.centres, members, children)):
            row = children * (parent + 1) + i
            rows[row] = _node(lamps, part)
            if level + 1 < levels:
                pending.append((row, level + 1, part))
            else:
                row_of[part] = row
    return rows, row_of


def _divide(
    centres: NDArray[np.float64], members: NDArray[np.int64], parts: int
) -> list[NDArray[np.int64]]:
    """Members in at most so many parts of about equal size, of lamps near each other."""
    if len(members) <= parts:
        return [members[i : i + 1] for i in range(len(members))]
    if parts == 1:
        return [members]
    axis = np.ptp(centres[members], axis=0).argmax()
    members = members[np.argsort(centres[members, axis], kind="stable")]
    left = (parts + 1) // 2
    middle = round(len(members) * left / parts)
    return [
        *_divide(centres, members[:middle], left),
        *_divide(centres, members[middle:], parts - left),
    ]


def _node(lamps: Lamps, members: NDArray[np.int64]) -> NDArray[np.float64]:
    """Numbers [12] of the node of some lamps."""
    centres, radii = lamps.centres[members], lamps.radii[members, None]
    low, high = (centres - radii).min(axis=0), (centres + radii).max(axis=0)
    centre = (low + high) / 2
    radius = (np.linalg.norm(centres - centre, axis=1) + radii[:, 0]).max()
    total = lamps.intensities[members].sum(axis=0)
    total = (1 - _EVEN_PART) * total + _EVEN_PART * total.mean()
    return np.array([*centre, radius, *total[:3], 0, *total[3:], 0])


class LampChoice:
    """The tree on the device.

    Args:
        lamps: at least one.
        indices: [N] index of each lamp's emitter in the scene.
    """

    def __init__(self, lamps: Lamps, indices: NDArray[np.integer]) -> None:
        levels, children = tree_shape(len(lamps))
        self._levels, self._children = (parameter(mi.UInt32, n) for n in (levels, children))
        rows, row_of = make_nodes(lamps)
        self._rows = on_device(mi.Float, rows)
        index_of = np.full(len(rows), NO_LAMP, np.uint32)
        index_of[row_of] = indices
        self._index_of = on_device(mi.UInt32, index_of)
        rows_of = np.full(int(np.max(indices)) + 1, NO_LAMP, np.uint32)
        rows_of[indices] = row_of
        self._row_of = on_device(mi.UInt32, rows_of)
        self._count = parameter(mi.UInt32, len(rows_of))

    @dr.syntax
    def sample(
        self,
        x: mi.Point3f,
        n: mi.Vector3f,
        excluded: mi.UInt32,
        sample: mi.Float,
        active: mi.Bool,
    ) -> tuple[mi.UInt32, mi.Float, mi.Float]:
        """Choose a lamp.

        Args:
            x, n: receivers, and their normals: unit vectors, or 0.
            excluded: index in the scene of a lamp that is not chosen, or `NO_LAMP`.
            sample: in [0, 1).
            active: mask.

        Returns:
            Index in the scene; its probability, 0 where no lamp sends light; and Σ w over the first
            level.
        """
        excluded_row = self._row(excluded, active)
        sample, pmf = mi.Float(sample), dr.select(active, mi.Float(1), 0)
        row, first = dr.zeros(mi.UInt32, dr.width(x)), dr.zeros(mi.UInt32, dr.width(x))
        top, level = dr.zeros(mi.Float, dr.width(x)), mi.UInt32(0)
        while active & (level < self._levels):
            total, chosen = mi.Float(0), mi.Float(0)
            child = mi.UInt32(0)
            while active & (child < self._children):
                here = first + child
                weight = self._weight(here, x, n, active)
                weight = dr.select(here == excluded_row, 0, weight)
                total += weight
                # Each child takes the place of those before with its part of the sum so far.
                part = dr.select(weight > 0, weight / total, 0)
                taken = sample < part
                rest = dr.select(taken, sample / part, (sample - part) / (1 - part))
                sample = dr.select(part > 0, dr.minimum(rest, 1 - 2.0**-24), sample)
                chosen = dr.select(taken, weight, chosen)
                row = dr.select(taken, here, row)
                child += 1
            pmf *= dr.select(total > 0, chosen / total, 0)
            top = dr.select(level == 0, total, top)
            first = self._children * (row + 1)
            level += 1
        return dr.gather(mi.UInt32, self._index_of, row, active & (pmf > 0)), pmf, top

    def part(
        self,
        index: mi.UInt32,
        x: mi.Point3f,
        n: mi.Vector3f,
        total: mi.Float,
        active: mi.Bool,
    ) -> mi.Float:
        """The lamp's own w over Σ w of the first level, at most 1.

        With one level it is the probability of `sample`; with more it differs by how far a node's w
        is from the sum of its lamps'. Multiple importance sampling takes it in place of the
        probability: weights stay those of an unbiased estimate as long as both sides take the
        same numbers, and this one needs no traversal of the tree.

        Args:
            index: of the lamp in the scene.
            x, n: as for `sample`.
            total: Σ w over the first level, as `sample` returned it.
            active: mask.

        Returns:
            The part; 0 for an index that is no lamp's.
        """
        row = self._row(index, active)
        weight = self._weight(row, x, n, active & (row != NO_LAMP))
        return dr.select(weight > 0, dr.minimum(weight / total, 1), 0)

    def _row(self, index, active):
        known = mi.Bool(active) & (index < self._count)
        return dr.select(known, dr.gather(mi.UInt32, self._row_of, index, known), NO_LAMP)

    def _weight(self, row, x, n, active):
        """w of a node."""
        centre, high, low = (
            dr.gather(mi.Vector4f, self._rows, _PACKETS * row + i, active) for i in range(_PACKETS)
        )
        offset = mi.Vector3f(x) - mi.Vector3f(centre.x, centre.y, centre.z)
        squared, radius = dr.maximum(dr.squared_norm(offset), dr.smallest(mi.Float)), centre.w
        inverse = dr.rsqrt(squared)
        direction = offset * inverse
        part, towards = dr.square(direction), direction > 0
        intensity = part.x * dr.select(towards.x, high.x, low.x)
        intensity += part.y * dr.select(towards.y, high.y, low.y)
        intensity += part.z * dr.select(towards.z, high.z, low.z)
        spread = dr.minimum(radius * inverse + _SLACK, 1)
        cosine = (spread - dr.dot(n, direction)) / (1 + spread)
        cosine = dr.maximum(cosine, dr.select(squared < dr.square(radius), _LEAST_COSINE, 0))
        cosine = dr.select(dr.squared_norm(n) > 0, dr.minimum(cosine, 1), 1)
        weight = intensity * cosine / dr.maximum(squared, dr.square(radius) / 4)
        return dr.select(active, weight, 0)
