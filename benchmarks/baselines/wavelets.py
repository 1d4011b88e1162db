"""A light field on the box, compressed by Haar wavelets and sampled down their tree.

After Atanasov and Koylazov, "Wavelet Representation and Sampling of Complex Luminaires", Computer
Graphics Forum 44(4), 2025. It is rebuilt from the abstract and from what the manual of V-Ray 7 says
of its luminaires, not from the article or its code, so that all sizes and formats here are our own.

As there: a 4D light field on a box, of traced light, smoothed by a 4D Gaussian filter; wavelets
compress it; it is sampled from coarse to fine over their bands. Not as there:

* There is no stochastic filter where the light field is evaluated: `Representation.eval` takes no
  random numbers.
* Samples towards a receiver begin with the coarsest band, and not with tables for viewpoints.
* The parts of the tree that are stored are reconstructed when it is loaded, and not for each ray.
  So a query is a few memory loads, and the device holds 24 bytes a slot, 9 to 30 times the bytes of
  the file. That favours this baseline's times. `num_bytes` is the file.
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import gaussian_filter

from benchmarks.baselines.traced_rays import TracedRays
from benchmarks.baselines.wavelet_tree import CHILDREN, compress, transform
from lumitree.core.device import on_device
from lumitree.rendering.sampling.proxy import safe_inverse, slab
from lumitree.trace.emitted_rays import RayBatch, seeded_sampler

# Standard deviation of the filter, in cells of each axis.
FILTER_WIDTH = 0.5
# Part of the samples towards a receiver that choose among children without regard to their light:
# what is dark in the direction from the middle of a square may be bright from its other points.
_UNIFORM_SHARE = 0.1
# Half extents, the numbers of cells, and the largest exponent of the coefficients: six numbers.
_HEADER_BYTES = 24


class BoxCells:
    """Cells of a light field on the faces of a box about the origin.

    Face 2 a + 1 is at the positive end of axis a, face 2 a at the negative end; its sides are the
    two axes that follow. On each, the unit square is divided into cells of position, and the
    hemisphere above it into cells of direction of equal solid angle.

    Args:
        half_extents: [3], of the box.
        positions, directions: cells along a side of the two squares.

    Attributes:
        shape: number of cells: faces, the two axes of position, the two axes of direction.
        solid_angle: of a cell, sr.
    """

    def __init__(self, half_extents: NDArray[np.floating], positions: int, directions: int) -> None:
        self._half = np.asarray(half_extents, np.float64)
        self.shape = (6, positions, positions, directions, directions)
        self.solid_angle = 2 * np.pi / directions**2

    def leaving(self, origin: Any, direction: Any) -> tuple[Any, Any, Any, Any]:
        """Where a line leaves the box.

        Args:
            origin: mi.Point3f, on the line.
            direction: mi.Vector3f, unit direction that the light takes.

        Returns:
            mi.UInt32, face; mi.Point2f, place in its unit square; mi.Vector3f, direction by sides
            and outward normal of the face; mi.Bool, whether the line meets the box.
        """
        half = mi.Vector3f(self._half)
        enters, leaves = slab(-mi.Vector3f(origin), half, safe_inverse(direction))
        distance = dr.min(leaves)
        face = mi.UInt32(0)
        for axis in range(3):
            number = dr.select(direction[axis] > 0, mi.UInt32(2 * axis + 1), 2 * axis)
            face = dr.select(leaves[axis] == distance, number, face)
        point = self.by_sides(face, mi.Vector3f(origin + distance * direction) / half)
        place = dr.clip((mi.Point2f(point.x, point.y) + 1) / 2, 0, 1)
        return face, place, self.by_sides(face, direction), dr.max(enters) < distance

    def point(self, face: Any, place: Any) -> Any:
        """Point (mi.Point3f) at a place in the unit square of a face."""
        point = mi.Vector3f(2 * place.x - 1, 2 * place.y - 1, 1)
        return mi.Point3f(self.by_axes(face, point) * mi.Vector3f(self._half))

    def by_sides(self, face: Any, vector: Any) -> Any:
        """Components of a vector along the sides and the outward normal of a face."""
        axis, (x, y, z) = face // 2, vector
        turned = dr.select(axis == 1, mi.Vector3f(z, x, y), mi.Vector3f(x, y, z))
        turned = dr.select(axis == 0, mi.Vector3f(y, z, x), turned)
        return mi.Vector3f(turned.x, turned.y, _signed(face, turned.z))

    def by_axes(self, face: Any, vector: Any) -> Any:
        """The vector that has these components along the sides and the outward normal."""
        axis, u, v, normal = face // 2, vector.x, vector.y, _signed(face, vector.z)
        turned = dr.select(axis == 1, mi.Vector3f(v, normal, u), mi.Vector3f(u, v, normal))
        return dr.select(axis == 0, mi.Vector3f(normal, u, v), turned)

    def area(self, face: Any) -> Any:
        """Area (mi.Float) of a face, local units²."""
        x, y, z = (float(each) for each in self._half)
        axis = face // 2
        return 4 * dr.select(axis == 0, y * z, dr.select(axis == 1, z * x, x * y))

    def visible(self, x: Any, axis: int) -> tuple[Any, Any]:
        """The face (mi.UInt32) across an axis that looks to a point, and whether any does."""
        number = dr.select(x[axis] > 0, mi.UInt32(2 * axis + 1), 2 * axis)
        return number, dr.abs(x[axis]) > float(self._half[axis])

    def cell(self, place: Any, local: Any) -> tuple[Any, Any, Any, Any]:
        """Indices (mi.UInt32) along the four axes, of what `leaving` returns."""
        square = mi.warp.uniform_hemisphere_to_square(local)
        return *_indices(place, self.shape[1]), *_indices(square, self.shape[3])


def binned(rays: TracedRays, cells: BoxCells) -> NDArray[Any]:
    """Flux float64 [6, P, P, D, D, 3] of rays by the cell in which they leave."""
    origin = on_device(mi.Point3f, rays.origin)
    direction = on_device(mi.Vector3f, rays.direction)
    face, place, local, _ = cells.leaving(origin, direction)
    index = [np.array(each).astype(np.int64) for each in (face, *cells.cell(place, local))]
    row, size = np.ravel_multi_index(index, cells.shape), int(np.prod(cells.shape))
    flux = np.stack([np.bincount(row, each, size) for each in rays.flux.T], axis=-1)
    return flux.reshape(*cells.shape, 3)


def filtered(flux: NDArray[np.floating], width: float) -> NDArray[np.floating]:
    """Flux [6, P, P, D, D, 3], smoothed over the four axes; each face keeps its sum.

    Args:
        width: standard deviation of the Gaussian, in cells. It is mirrored at the borders.
    """
    return gaussian_filter(flux, (0, width, width, width, width, 0), mode="reflect")


class WaveletLight:
    """A light field, as the largest coefficients of its Haar transform.

    Args:
        flux: [6, P, P, D, D, 3] of `cells`; P and D are powers of 2, and P is at most D.
        num_bytes: that the coefficients may take, see `wavelet_tree.compress`, which says what it
            does about negative light.
    """

    def __init__(self, flux: NDArray[np.floating], cells: BoxCells, num_bytes: float) -> None:
        tree = compress(transform(flux), num_bytes)
        self._cells, self.num_bytes = cells, tree.num_bytes + _HEADER_BYTES
        positions, directions = cells.shape[1], cells.shape[3]
        self._levels = positions.bit_length() - 1
        # Cells of direction along a side at the coarsest level, where a face is one of position.
        self._coarse = directions // positions
        # Of all channels: this decides what is sampled.
        light = tree.values.sum(axis=1)
        self._values = on_device(mi.Float, np.column_stack([tree.values, light]).ravel())
        self._first = on_device(mi.UInt32, tree.first)
        self._splits = on_device(mi.Float, tree.splits)
        parts = light[: 6 * self._coarse**2] * float(CHILDREN) ** self._levels
        self._flux = float(parts.sum())
        self._parts = mi.DiscreteDistribution(on_device(mi.Float, parts))

    def draw(self, count: int, seed: int) -> RayBatch:
        """As `EmittedRays.draw`: all rays have the same flux, all channels together.

        A uniform sample of each of the four axes is warped by the splits from level to level
        (Clarberg et al. 2005, Wavelet importance sampling), and what remains of it is the place in
        the part where the tree ends.
        """
        sampler = seeded_sampler(seed, count)
        slot = self._parts.sample(sampler.next_1d())
        samples = [*sampler.next_2d(), *sampler.next_2d()]
        face, part = slot // self._coarse**2, slot % self._coarse**2
        corners = [mi.Float(0), mi.Float(0)]
        corners += [mi.Float(part // self._coarse), mi.Float(part % self._coarse)]
        width, inside = mi.Float(1), mi.Bool(True)
        for _ in range(self._levels):
            first = dr.gather(mi.UInt32, self._first, slot, inside)
            inside &= first > 0
            width = dr.select(inside, width / 2, width)
            child = mi.UInt32(1)
            for axis in range(4):
                split = dr.gather(mi.Float, self._splits, first + child, inside)
                upper, warped = _halved(samples[axis], split)
                samples[axis] = dr.select(inside, warped, samples[axis])
                corners[axis] = dr.select(inside & upper, corners[axis] + width, corners[axis])
                child = 2 * child + dr.select(upper, mi.UInt32(1), 0)
            # The first of the four steps began at 1, which is now the bit above those of the child.
            slot = dr.select(inside, first + child - CHILDREN, slot)
        u, v, s, t = (
            dr.fma(width, sample, corner) for sample, corner in zip(samples, corners, strict=True)
        )
        local = mi.warp.square_to_uniform_hemisphere(mi.Point2f(s, t) / self._coarse)
        value = dr.gather(mi.Vector4f, self._values, slot)
        # Rounded splits may lead to a part without light.
        scale = dr.select(value.w > 0, dr.rcp(value.w), 0) * (self._flux / count)
        point = self._cells.point(face, mi.Point2f(u, v))
        direction = self._cells.by_axes(face, local)
        flux = mi.Color3f(value.x, value.y, value.z) * scale
        dr.eval(point, direction, flux)
        return RayBatch(point, direction, flux)

    def sample_direction(self, x: Any, sampler: Any) -> tuple[Any, Any]:
        """As `Representation.sample_direction`, towards a point of the box.

        A face is chosen, then level by level a quarter of the square before, by how much light each
        sends to the receiver: estimated from the band of that level, in the direction from the
        middle of the square. The estimator does not depend on these estimates.
        """
        chosen = [self._cells.visible(x, axis) for axis in range(3)]
        corner = (mi.UInt32(0), mi.UInt32(0))
        pmfs = _probabilities(
            [self._towards(x, face, corner, 0) for face, _ in chosen], [each for _, each in chosen]
        )
        sample = sampler.next_1d()
        face, pmf = chosen[2][0], pmfs[2]
        for index, bound in ((1, pmfs[0] + pmfs[1]), (0, pmfs[0])):
            face = dr.select(sample < bound, chosen[index][0], face)
            pmf = dr.select(sample < bound, pmfs[index], pmf)
        (u, v), (sample_u, sample_v) = corner, sampler.next_2d()
        for level in range(1, self._levels + 1):
            quarters = [(2 * u + i, 2 * v + j) for i in (0, 1) for j in (0, 1)]
            p = _probabilities([self._towards(x, face, each, level) for each in quarters])
            upper_u, sample_u = _halved(sample_u, p[0] + p[1])
            row = dr.select(upper_u, p[2] + p[3], p[0] + p[1])
            upper_v, sample_v = _halved(sample_v, dr.select(upper_u, p[2], p[0]) / row)
            pmf *= dr.select(
                upper_u, dr.select(upper_v, p[3], p[2]), dr.select(upper_v, p[1], p[0])
            )
            u = 2 * u + dr.select(upper_u, mi.UInt32(1), 0)
            v = 2 * v + dr.select(upper_v, mi.UInt32(1), 0)
        place = (mi.Point2f(u, v) + mi.Point2f(sample_u, sample_v)) / self._cells.shape[1]
        offset = mi.Vector3f(x - self._cells.point(face, place))
        distance = dr.norm(offset)
        direction = offset / distance
        local = self._cells.by_sides(face, direction)
        intensity = self._intensity(face, place, local)
        value = intensity / (pmf * dr.square(distance))
        return -direction, dr.select((local.z > 0) & (pmf > 0), value, 0)

    def eval(self, origin: Any, direction: Any) -> Any:
        """As `Representation.eval`."""
        face, place, local, hit = self._cells.leaving(origin, direction)
        area = self._cells.area(face) / self._cells.shape[1] ** 2 * local.z
        radiance = self._intensity(face, place, local) / area
        return dr.select(hit & (area > 0), radiance, 0)

    def _intensity(self, face: Any, place: Any, local: Any) -> Any:
        """Radiant intensity (mi.Color3f) of the cell of position at a place, in a direction."""
        slot = self._slot(face, self._cells.cell(place, local), self._levels)
        value = dr.gather(mi.Vector4f, self._values, slot)
        return mi.Color3f(value.x, value.y, value.z) / self._cells.solid_angle

    def _towards(self, x: Any, face: Any, corner: tuple[Any, Any], level: int) -> Any:
        """Estimate of what a square of a level sends to a receiver, up to a factor of the level.

        Args:
            x: mi.Point3f, receiver.
            corner: mi.UInt32 each, number of the square along the sides of the face.
        """
        squares = 1 << level
        place = (mi.Point2f(*corner) + 0.5) / squares
        offset = mi.Vector3f(x - self._cells.point(face, place))
        local = self._cells.by_sides(face, dr.normalize(offset))
        square = mi.warp.uniform_hemisphere_to_square(local)
        slot = self._slot(face, (*corner, *_indices(square, self._coarse * squares)), level)
        light = dr.gather(mi.Float, self._values, 4 * slot + 3)
        # 1 / d² at a distance; near by, as for a disk of the square's area around its middle.
        spread = self._cells.area(face) / (np.pi * squares**2)
        return dr.select(local.z > 0, light / (dr.squared_norm(offset) + spread), 0)

    def _slot(self, face: Any, cell: tuple[Any, Any, Any, Any], level: int) -> Any:
        """Slot of a part of the light field, or of the smallest stored part that contains it.

        Args:
            face: mi.UInt32.
            cell: mi.UInt32 each, number of the part along the four axes.
            level: of the part; 0 is the coarsest.
        """
        s, t = cell[2] >> level, cell[3] >> level
        slot, inside = (face * self._coarse + s) * self._coarse + t, mi.Bool(True)
        for bit in range(level - 1, -1, -1):
            first = dr.gather(mi.UInt32, self._first, slot, inside)
            inside &= first > 0
            child = mi.UInt32(0)
            for each in cell:
                child = 2 * child + ((each >> bit) & 1)
            slot = dr.select(inside, first + child, slot)
        return slot


def _signed(face: Any, value: Any) -> Any:
    """A value (mi.Float) along an axis by the outward normal of a face, or the other way."""
    return dr.select((face & 1) == 1, value, -value)


def _indices(place: Any, count: int) -> tuple[Any, Any]:
    """Indices (mi.UInt32) of a place in the unit square of `count`² cells."""
    index = mi.Point2u(dr.clip(mi.Point2i(place * count), 0, count - 1))
    return index.x, index.y


def _halved(sample: Any, probability: Any) -> tuple[Any, Any]:
    """Whether a sample (mi.Float) chooses the upper half, and what remains of it, uniform again.

    Args:
        probability: mi.Float, of the lower half.
    """
    upper = sample >= probability
    warped = dr.select(upper, (sample - probability) / (1 - probability), sample / probability)
    return upper, dr.clip(warped, 0, 1)


def _probabilities(weights: list[Any], possible: list[Any] | None = None) -> list[Any]:
    """Probabilities in proportion to weights, but for `_UNIFORM_SHARE`.

    Args:
        weights: mi.Float each.
        possible: mi.Bool each; by default all are.
    """
    if possible is None:
        possible = [mi.Bool(True)] * len(weights)
    weights = [dr.select(each, w, 0) for each, w in zip(possible, weights, strict=True)]
    total, count = sum(weights), sum(dr.select(each, mi.Float(1), 0) for each in possible)
    scale = dr.select(total > 0, (1 - _UNIFORM_SHARE) / total, 0)
    floor = dr.select(total > 0, _UNIFORM_SHARE, 1) / count
    return [
        dr.select(each, scale * w + floor, 0) for each, w in zip(possible, weights, strict=True)
    ]
