"""Importance sampling of what a field emits, in the luminaire's local frame.

A field's emission is enclosed in a few boxes, small where it is bright. Each knows the radiance it
sends by direction, so what it sends to a point is about that times its solid angle; a box is chosen in
that proportion, and a direction by a point on the box's faces. The density of a direction is the sum
over all boxes that its line meets, mixed with the proxy's uniform density, so that no direction that
may carry light is left out. Lines that leave the lamp are drawn from the same tables.

Symbols
    c, h    centre and half extents of a box
    delta   c - x, from the shading point x to the box
    L       root mean square of a box's radiance over its silhouette, by direction
    t, r    distance from x to the box's face along a direction, and to its centre
    S       sum of area times distance over the box's visible faces; S / r³ is its solid angle
"""

from typing import TYPE_CHECKING, Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.render.clusters import cluster_cells
from lumitree.render.proxy import (
    Proxy,
    cone_pdf,
    face_areas,
    point_on_box,
    safe_inverse,
    sample_cone,
    slab,
)

if TYPE_CHECKING:
    from lumitree.render.field import Field

SAMPLING_KINDS = ("emission", "uniform")
NUM_BOXES = 32
_NO_BOX = NUM_BOXES
# Directions are binned by the octahedral map: RESOLUTION² bins.
RESOLUTION = 16
_NUM_BINS = RESOLUTION * RESOLUTION
# Cells a side of the grid that the boxes are made of, and rays of the two tables.
_GRID = 64
_GRID_RAYS = 1 << 20
_RAYS_PER_BIN = 32
# No direction of a box is held to be darker than this part of its mean.
_FLOOR = 0.2
# Part of the samples that is taken uniformly from the proxy.
UNIFORM_FRACTION = 0.1


class LightBoxes:
    """Boxes around a field's emission, with the radiance each sends by direction."""

    def __init__(self, field: "Field") -> None:
        half_extents = field.asset.half_extents
        cell = 2 * half_extents / _GRID
        clusters = cluster_cells(_power_grid(field), cell, NUM_BOXES)
        lower = np.array([cells.min(axis=0) for cells in clusters])
        upper = np.array([cells.max(axis=0) + 1 for cells in clusters])
        centre, half = (lower + upper) / 2 * cell - half_extents, (upper - lower) / 2 * cell
        self.count = mi.UInt32(len(clusters))
        self._centre, self._half = mi.Float(centre.ravel()), mi.Float(half.ravel())
        dr.make_opaque(self.count, self._centre, self._half)
        owner = np.full((_GRID,) * 3, _NO_BOX, np.uint32)
        for index, cells in enumerate(clusters):
            owner[tuple(cells.T)] = index
        radiance = self._tabulate(field, len(clusters), mi.UInt32(owner.ravel()))
        self._radiance = mi.Float(radiance)
        self._line_choice = mi.DiscreteDistribution(radiance * self._bin_extents(len(clusters)))

    def _bin_extents(self, count):
        """Projected area times solid angle [count * bins] of each box and bin."""
        index = dr.arange(mi.UInt32, count * _NUM_BINS)
        direction, density = _direction_in_bin(index % _NUM_BINS, mi.Point2f(0.5))
        _, half = self._box(index // _NUM_BINS)
        return np.array(dr.sum(_projected_areas(half, direction)) / density)

    def _tabulate(self, field, count, owner):
        """Root mean square of the radiance [count * bins] of each box's own cells, by direction."""
        index = dr.arange(mi.UInt32, count * _NUM_BINS * _RAYS_PER_BIN)
        bin_index = index // _RAYS_PER_BIN
        box = bin_index // _NUM_BINS
        centre, half = self._box(box)
        rng = mi.PCG32(len(index), 1)
        uniform = lambda: rng.next_float32()  # noqa: E731
        towards, _ = _direction_in_bin(bin_index % _NUM_BINS, mi.Point2f(uniform(), uniform()))
        weights = _projected_areas(half, towards)
        p = point_on_box(half, weights, towards, mi.Point2f(uniform(), uniform()))
        start = centre + p
        seen = dr.zeros(mi.Float, len(index))

        def record(distance, emission, active):
            cell = _cell(start - distance * towards, field)
            own = active & (dr.gather(mi.UInt32, owner, cell, active) == box)
            dr.scatter_reduce(dr.ReduceOp.Add, seen, dr.mean(emission), index, own)

        dr.eval(field.emission(start, -towards, record=record), seen)
        square = dr.block_sum(dr.square(seen), _RAYS_PER_BIN) / _RAYS_PER_BIN
        radiance = dr.sqrt(square)
        mean = dr.repeat(dr.block_sum(radiance, _NUM_BINS) / _NUM_BINS, _NUM_BINS)
        radiance = dr.maximum(radiance, _FLOOR * mean)
        # Nothing shines: any choice of boxes will do, as long as it is one.
        return np.array(dr.select(dr.max(radiance) > 0, radiance, 1))

    def _box(self, index, active=True):
        centre = dr.gather(mi.Vector3f, self._centre, index, active)
        return centre, dr.gather(mi.Vector3f, self._half, index, active)

    def _seen(self, index, origin, active):
        """delta, h, L and 1 / r of a box from a point."""
        centre, half = self._box(index, active)
        delta = centre - origin
        bin_index = index * _NUM_BINS + _bin(-delta)
        radiance = dr.gather(mi.Float, self._radiance, bin_index, active)
        return delta, half, radiance, dr.rsqrt(dr.squared_norm(delta))

    @dr.syntax
    def sample(self, origin: Any, sample: Any, active: Any) -> tuple[Any, Any]:
        """Direction from `origin` for a sample in the unit square, and the box it was aimed at."""
        u = mi.Float(sample.x)
        total = mi.Float(0)
        chosen = mi.UInt32(0)
        i = mi.UInt32(0)
        while active & (i < self.count):
            delta, half, radiance, inverse = self._seen(i, origin, active)
            weight = radiance * dr.sum(_face_weights(delta, half)) * inverse * inverse * inverse
            total += weight
            # Keep the new box with probability weight / total, and use what is left of u again.
            share = dr.select(total > 0, weight / total, 0)
            take = u < share
            chosen = dr.select(take, i, chosen)
            u = dr.select(take, u / share, (u - share) / (1 - share))
            i += 1
        centre, half = self._box(chosen, active)
        delta = centre - origin
        u = dr.clip(u, 0, dr.one_minus_epsilon(mi.Float))
        p = point_on_box(half, _face_weights(delta, half), -delta, mi.Point2f(u, sample.y))
        return dr.normalize(delta + p), chosen

    @dr.syntax
    def pdf(self, origin: Any, direction: Any, active: Any, aimed_at: Any) -> Any:
        """Density with which `sample` gives `direction` from `origin`.

        Args:
            aimed_at: index of a box that the direction is known to meet, whatever rounding says.
        """
        inverse_direction = safe_inverse(direction)
        total = mi.Float(0)
        density = mi.Float(0)
        i = mi.UInt32(0)
        while active & (i < self.count):
            delta, half, radiance, inverse = self._seen(i, origin, active)
            weights = _face_weights(delta, half)
            total += radiance * dr.sum(weights) * inverse * inverse * inverse
            planes_near, planes_far = slab(delta, half, inverse_direction)
            near, far = dr.max(planes_near), dr.min(planes_far)
            hit = ((near > 0) & (near <= far)) | (i == aimed_at)
            # Box by its solid angle S / r³, then direction by t³ / S.
            density += dr.select(hit, radiance * (near * inverse) ** 3, 0)
            i += 1
        return dr.select(total > 0, density / total, 0)


    def sample_line(self, choice: Any, sample1: Any, sample2: Any) -> tuple[Any, Any]:
        """Point inside the lamp and direction of travel of a line that leaves it."""
        index = self._line_choice.sample(choice)
        direction, _ = _direction_in_bin(index % _NUM_BINS, sample1)
        centre, half = self._box(index // _NUM_BINS)
        weights = _projected_areas(half, direction)
        return centre + point_on_box(half, weights, direction, sample2), direction

    @dr.syntax
    def line_pdf(self, point: Any, direction: Any, active: Any) -> Any:
        """Density of `sample_line` over projected area and solid angle."""
        inverse_direction = safe_inverse(direction)
        bin_index = _bin(direction)
        density = mi.Float(0)
        i = mi.UInt32(0)
        while active & (i < self.count):
            centre, half = self._box(i, active)
            planes_near, planes_far = slab(centre - point, half, inverse_direction)
            share = self._line_choice.eval_pmf_normalized(i * _NUM_BINS + bin_index, active)
            hit = dr.max(planes_near) <= dr.min(planes_far)
            density += dr.select(hit, share / dr.sum(_projected_areas(half, direction)), 0)
            i += 1
        return density * _bin_density(direction)


class EmitterSampler:
    """Directions towards a field: its boxes mixed with the proxy's uniform sampling.

    Args:
        proxy: what is sampled uniformly.
        half_extents: [3] the box around the field, local units.
        boxes: None for uniform sampling alone.
    """

    def __init__(
        self, proxy: Proxy, half_extents: NDArray[np.float64], boxes: LightBoxes | None
    ) -> None:
        self._proxy = proxy
        self._half = mi.Vector3f(*half_extents.tolist())
        self._radius = float(np.linalg.norm(half_extents))
        self._boxes = boxes

    def sample(self, origin: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Unit direction from `origin` for a sample in the unit square, and its density.

        Args:
            origin: mi.Point3f, local frame.
            sample: mi.Point2f.
            active: mi.Bool mask.

        Returns:
            mi.Vector3f; mi.Float per steradian, 0 where there is no valid direction.
        """
        if self._boxes is None:
            direction = self._proxy.sample(origin, sample)
            return direction, self._proxy.pdf(origin, direction)
        uniform, rest = _divide_sample(sample.x)
        sample = mi.Point2f(rest, sample.y)
        aimed, box = self._boxes.sample(origin, sample, active)
        direction = dr.select(uniform, sample_cone(origin, self._radius, sample), aimed)
        box = dr.select(uniform, _NO_BOX, box)
        return direction, self._density(origin, direction, active, box)

    def pdf(self, origin: Any, direction: Any, active: Any = True) -> Any:
        """Density with which `sample` gives `direction` from `origin`, per steradian."""
        if self._boxes is None:
            return self._proxy.pdf(origin, direction)
        return self._density(origin, direction, active, mi.UInt32(_NO_BOX))

    def sample_line(
        self, choice: Any, sample1: Any, sample2: Any, active: Any = True
    ) -> tuple[Any, Any, Any]:
        """Line along which light leaves the lamp.

        Args:
            choice: mi.Float in [0, 1).
            sample1, sample2: mi.Point2f in the unit square.
            active: mi.Bool mask.

        Returns:
            A point of the line inside the proxy, the unit direction of travel, and the density over
            projected area (local units) and solid angle.
        """
        direction = mi.warp.square_to_uniform_sphere(sample1)
        areas = _projected_areas(self._half, direction)
        point = point_on_box(self._half, areas, direction, sample2)
        if self._boxes is None:
            return mi.Point3f(point), direction, dr.inv_four_pi / dr.sum(areas)
        uniform, rest = _divide_sample(choice)
        aimed_point, aimed = self._boxes.sample_line(rest, sample1, sample2)
        point = dr.select(uniform, point, aimed_point)
        direction = dr.select(uniform, direction, aimed)
        density = dr.inv_four_pi / dr.sum(_projected_areas(self._half, direction))
        aimed_density = self._boxes.line_pdf(point, direction, active)
        return mi.Point3f(point), direction, dr.lerp(aimed_density, density, UNIFORM_FRACTION)

    def _density(self, origin, direction, active, box):
        # Where the proxy's own density is 0 nothing is emitted: from inside, and past it.
        valid = self._proxy.pdf(origin, direction) > 0
        aimed = self._boxes.pdf(origin, direction, active & valid, box)
        uniform = cone_pdf(origin, self._radius)
        return dr.select(valid, dr.lerp(aimed, uniform, UNIFORM_FRACTION), 0)


def _divide_sample(sample):
    """Whether to sample uniformly, and a sample in [0, 1) to do either with."""
    uniform = sample < UNIFORM_FRACTION
    rest = (sample - UNIFORM_FRACTION) / (1 - UNIFORM_FRACTION)
    rest = dr.select(uniform, sample / UNIFORM_FRACTION, rest)
    return uniform, dr.clip(rest, 0, dr.one_minus_epsilon(mi.Float))


def _face_weights(delta, half):
    """Area times distance of the faces that can be seen [3]: solid angle but for 1 / r³."""
    return face_areas(half) * dr.maximum(dr.abs(delta) - half, 0)


def _projected_areas(half, direction):
    """Areas [3] of the faces of a box as seen along a direction."""
    return face_areas(half) * dr.abs(direction)


def _octahedral(direction):
    """Octahedral coordinates in [-1, 1]² of a direction of any length."""
    n = direction / dr.sum(dr.abs(direction))
    folded = mi.Vector2f(
        dr.copysign(1 - dr.abs(n.y), n.x),
        dr.copysign(1 - dr.abs(n.x), n.y),
    )
    return dr.select(n.z < 0, folded, mi.Vector2f(n.x, n.y))


def _bin(direction):
    """Index of the bin of a direction of any length."""
    uv = _octahedral(direction)
    cell = mi.Point2u(dr.clip(mi.Point2i((uv + 1) * (RESOLUTION / 2)), 0, RESOLUTION - 1))
    return cell.y * RESOLUTION + cell.x


def _direction_in_bin(bin_index, sample):
    """Unit direction in a bin, uniform in octahedral coordinates, and its density there."""
    cell = mi.Point2f(bin_index % RESOLUTION, bin_index // RESOLUTION)
    uv = (cell + sample) * (2 / RESOLUTION) - 1
    z = 1 - dr.abs(uv.x) - dr.abs(uv.y)
    fold = dr.maximum(-z, 0)
    v = mi.Vector3f(uv.x - dr.copysign(fold, uv.x), uv.y - dr.copysign(fold, uv.y), z)
    direction = dr.normalize(v)
    return direction, _bin_density(direction)


def _bin_density(direction):
    """Density per steradian of `_direction_in_bin`, given the bin.

    Area on the octahedron and solid angle differ by the cube of the distance from the origin.
    """
    return (_NUM_BINS / 4) / dr.sum(dr.abs(direction)) ** 3


def _power_grid(field):
    """Light [GRID³], up to a factor, that leaves from each cell of a grid over the proxy box."""
    half = mi.Vector3f(*field.asset.half_extents.tolist())
    rng = mi.PCG32(_GRID_RAYS)
    uniform = lambda: mi.Point2f(rng.next_float32(), rng.next_float32())  # noqa: E731
    direction = mi.warp.square_to_uniform_sphere(uniform())
    weights = _projected_areas(half, direction)
    p = point_on_box(half, weights, -direction, uniform())
    projected = dr.sum(weights)
    grid = dr.zeros(mi.Float, _GRID**3)

    def record(distance, emission, active):
        index = _cell(p + distance * direction, field)
        value = dr.mean(emission) * projected
        dr.scatter_reduce(dr.ReduceOp.Add, grid, value, index, active)

    dr.eval(field.emission(mi.Point3f(p), direction, record=record), grid)
    return np.array(grid, np.float64).reshape(_GRID, _GRID, _GRID)


def _cell(point, field):
    """Index of the grid's cell that holds a point."""
    half = mi.Vector3f(*field.asset.half_extents.tolist())
    cell = mi.Vector3u(dr.clip(mi.Vector3i((point + half) / half * (_GRID / 2)), 0, _GRID - 1))
    return (cell.x * _GRID + cell.y) * _GRID + cell.z
