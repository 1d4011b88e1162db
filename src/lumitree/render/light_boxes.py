"""Boxes around what a field emits, and directions drawn from them, in the luminaire's local frame.

A field's emission is enclosed in a few boxes, small where it is bright. The space around the lamp
is divided into cells, by direction from its centre and by distance; for each cell a table holds the
share of the light that comes from each box. To sample a direction from x, a box is chosen by the
table, and a point on those of its faces that x sees; the density is the sum over all boxes that the
direction's line meets. Lines that leave the lamp are drawn from the farthest cells.

Symbols
    c, h    centre and half extents of a box
    delta   c - x, from the shading point x to the box
    t       distance from x to the box's face along a direction
    S       sum of area times distance over the box's visible faces; t³ / S is a direction's density
    R       radius of the bounding sphere
"""

from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.render.clusters import cluster_cells
from lumitree.render.octahedral import NUM_BINS, bin_density, bin_of, direction_in_bin
from lumitree.render.proxy import face_areas, point_on_box, projected_areas, safe_inverse, slab

if TYPE_CHECKING:
    from lumitree.render.field import Field

NUM_BOXES = 32
NO_BOX = NUM_BOXES
# Shells of equal width in R / distance, in which parallax is linear; the last has no end.
_NUM_SHELLS = 6
_SHELL_WIDTH = 0.25
_NUM_CELLS = _NUM_SHELLS * NUM_BINS
# Cells a side of the grid that the boxes are made of, and rays of the two tables.
_GRID = 64
_GRID_RAYS = 1 << 19
_RAYS_PER_ENTRY = 16
# No box is held to be darker than this part of its mean over the directions of a shell.
_FLOOR = 0.2


class LightBoxes:
    """Boxes around a field's emission, and how much light each sends where."""

    def __init__(self, field: "Field") -> None:
        half_extents = field.asset.half_extents
        cell = 2 * half_extents / _GRID
        clusters = cluster_cells(_power_grid(field), cell, NUM_BOXES)
        lower = np.array([cells.min(axis=0) for cells in clusters])
        upper = np.array([cells.max(axis=0) + 1 for cells in clusters])
        centre, half = (lower + upper) / 2 * cell - half_extents, (upper - lower) / 2 * cell
        self.count = mi.UInt32(len(clusters))
        self._radius = float(np.linalg.norm(half_extents))
        self._centre, self._half = mi.Float(centre.ravel()), mi.Float(half.ravel())
        dr.make_opaque(self.count, self._centre, self._half)
        owner = np.full((_GRID,) * 3, NO_BOX, np.uint32)
        for index, cells in enumerate(clusters):
            owner[tuple(cells.T)] = index
        self._set_shares(self._tabulate(field, len(clusters), mi.UInt32(owner.ravel())))

    def _set_shares(self, light):
        """Choices of a box by cell, and of a bin and box for lines, from `_tabulate`'s table."""
        light = light.reshape(_NUM_SHELLS, NUM_BINS, -1)
        light = np.maximum(light, _FLOOR * light.mean(axis=1, keepdims=True))
        # Where nothing shines any choice will do, as long as it is one.
        light = np.where(light.sum(axis=2, keepdims=True) > 0, light, 1)
        shares = np.zeros((_NUM_SHELLS, NUM_BINS, NUM_BOXES))
        shares[..., : light.shape[2]] = light / light.sum(axis=2, keepdims=True)
        self._share = mi.Float(shares.ravel())
        self._cumulated = mi.Float(np.cumsum(shares, axis=2).ravel())
        _, density = direction_in_bin(dr.arange(mi.UInt32, NUM_BINS), mi.Point2f(0.5))
        power = shares[0] * light[0].sum(axis=1, keepdims=True) / np.array(density)[:, None]
        self._line_choice = mi.DiscreteDistribution(power.ravel())

    def _tabulate(self, field, count, owner):
        """Light [cells * count] that each box's own cells send to each cell around the lamp.

        Root mean square of the estimator that samples the box, times squared distance: the best
        proportion in which to choose boxes.
        """
        index = dr.arange(mi.UInt32, _NUM_CELLS * count * _RAYS_PER_ENTRY)
        box = index // _RAYS_PER_ENTRY % count
        rng = mi.PCG32(len(index), 1)
        uniform = lambda: mi.Point2f(rng.next_float32(), rng.next_float32())  # noqa: E731
        origin = self._point_in_cell(
            field, index // (_RAYS_PER_ENTRY * count), uniform(), uniform().x
        )
        delta, half = self._seen(box, origin, True)
        weights = _face_weights(delta, half)
        line = delta + point_on_box(half, weights, -delta, uniform())
        direction = dr.normalize(line)
        seen = dr.zeros(mi.Float, len(index))

        def record(distance, emission, active):
            cell = _grid_cell(origin + distance * direction, field)
            own = active & (dr.gather(mi.UInt32, owner, cell, active) == box)
            dr.scatter_reduce(dr.ReduceOp.Add, seen, dr.mean(emission), index, own)

        dr.eval(field.emission(mi.Point3f(origin), direction, record=record), seen)
        pdf = dr.squared_norm(line) * dr.norm(line) / dr.sum(weights)
        light = seen / pdf * dr.squared_norm(origin)
        light = dr.select(dr.isfinite(light), light, 0)
        return np.sqrt(np.array(dr.square(light)).reshape(-1, _RAYS_PER_ENTRY).mean(axis=1))

    def _point_in_cell(self, field, cell, sample, shell_sample):
        """Random point of a cell around the lamp, outside the proxy box."""
        direction, _ = direction_in_bin(cell % NUM_BINS, sample)
        nearness = (mi.Float(cell // NUM_BINS) + shell_sample) * _SHELL_WIDTH
        half = mi.Vector3f(*field.asset.half_extents.tolist())
        surface = dr.min(half / dr.abs(direction))
        # Beyond 50 R nothing changes any more but the rounding.
        return direction * dr.maximum(self._radius / dr.maximum(nearness, 0.02), 1.001 * surface)

    def _seen(self, index, origin, active):
        """delta and h of a box from a point."""
        centre = dr.gather(mi.Vector3f, self._centre, index, active)
        return centre - origin, dr.gather(mi.Vector3f, self._half, index, active)

    def _row(self, origin):
        """Where the table's row for the cell of a point begins."""
        origin = mi.Vector3f(origin)
        nearness = self._radius * dr.rsqrt(dr.squared_norm(origin)) / _SHELL_WIDTH
        shell = mi.UInt32(dr.minimum(nearness, _NUM_SHELLS - 1))
        return (shell * NUM_BINS + bin_of(origin)) * NUM_BOXES

    def sample(self, origin: Any, sample: Any, active: Any) -> tuple[Any, Any]:
        """Direction from `origin` for a sample in the unit square, and the box it was aimed at."""
        row = self._row(origin)

        def below(index):
            return dr.gather(mi.Float, self._cumulated, row + index, active) <= sample.x

        box = dr.binary_search(0, NUM_BOXES - 1, below)
        box = dr.minimum(box, self.count - 1)
        share = dr.gather(mi.Float, self._share, row + box, active)
        end = dr.gather(mi.Float, self._cumulated, row + box, active)
        # What the choice leaves of the sample is used again.
        u = dr.clip((sample.x - end) / share + 1, 0, dr.one_minus_epsilon(mi.Float))
        delta, half = self._seen(box, origin, active)
        p = point_on_box(half, _face_weights(delta, half), -delta, mi.Point2f(u, sample.y))
        return dr.normalize(delta + p), box

    @dr.syntax
    def pdf(self, origin: Any, direction: Any, active: Any, aimed_at: Any) -> Any:
        """Density with which `sample` gives `direction` from `origin`.

        Args:
            aimed_at: index of a box that the direction is known to meet, whatever rounding says.
        """
        inverse_direction = safe_inverse(direction)
        row = self._row(origin)
        density = mi.Float(0)
        i = mi.UInt32(0)
        while active & (i < self.count):
            delta, half = self._seen(i, origin, active)
            planes_near, planes_far = slab(delta, half, inverse_direction)
            near, far = dr.max(planes_near), dr.min(planes_far)
            hit = active & (((near > 0) & (near <= far)) | (i == aimed_at))
            share = dr.gather(mi.Float, self._share, row + i, hit)
            total = dr.sum(_face_weights(delta, half))
            density += dr.select(hit & (total > 0), share * near * near * near / total, 0)
            i += 1
        return density

    def sample_line(self, choice: Any, sample1: Any, sample2: Any) -> tuple[Any, Any]:
        """Point inside the lamp and direction of travel of a line that leaves it."""
        index = self._line_choice.sample(choice)
        direction, _ = direction_in_bin(index // NUM_BOXES, sample1)
        centre, half = self._seen(index % NUM_BOXES, mi.Vector3f(0), True)
        weights = projected_areas(half, direction)
        return centre + point_on_box(half, weights, direction, sample2), direction

    @dr.syntax
    def line_pdf(self, point: Any, direction: Any, active: Any) -> Any:
        """Density of `sample_line` over projected area and solid angle."""
        inverse_direction = safe_inverse(direction)
        bin_index = bin_of(direction)
        density = mi.Float(0)
        i = mi.UInt32(0)
        while active & (i < self.count):
            delta, half = self._seen(i, point, active)
            planes_near, planes_far = slab(delta, half, inverse_direction)
            share = self._line_choice.eval_pmf_normalized(bin_index * NUM_BOXES + i, active)
            hit = dr.max(planes_near) <= dr.min(planes_far)
            density += dr.select(hit, share / dr.sum(projected_areas(half, direction)), 0)
            i += 1
        return density * bin_density(direction)


def _face_weights(delta, half):
    """Area times distance of the faces that can be seen [3]: solid angle but for 1 / r³."""
    return face_areas(half) * dr.maximum(dr.abs(delta) - half, 0)


def _power_grid(field):
    """Light [GRID³], up to a factor, that leaves from each cell of a grid over the proxy box.

    Root mean square over directions, so that a cell that is bright in few of them counts.
    """
    half = mi.Vector3f(*field.asset.half_extents.tolist())
    rng = mi.PCG32(_GRID_RAYS)
    uniform = lambda: mi.Point2f(rng.next_float32(), rng.next_float32())  # noqa: E731
    direction = mi.warp.square_to_uniform_sphere(uniform())
    weights = projected_areas(half, direction)
    p = point_on_box(half, weights, -direction, uniform())
    projected = dr.sum(weights)
    grid = dr.zeros(mi.Float, _GRID**3)

    def record(distance, emission, active):
        index = _grid_cell(p + distance * direction, field)
        value = dr.square(dr.mean(emission)) * projected
        dr.scatter_reduce(dr.ReduceOp.Add, grid, value, index, active)

    dr.eval(field.emission(mi.Point3f(p), direction, record=record), grid)
    return np.sqrt(np.array(grid, np.float64)).reshape(_GRID, _GRID, _GRID)


def _grid_cell(point, field):
    """Index of the power grid's cell that holds a point."""
    half = mi.Vector3f(*field.asset.half_extents.tolist())
    cell = mi.Vector3u(dr.clip(mi.Vector3i((point + half) / half * (_GRID / 2)), 0, _GRID - 1))
    return (cell.x * _GRID + cell.y) * _GRID + cell.z
