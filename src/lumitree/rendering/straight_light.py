"""Straight light: points of a lamp's emitters, whose light reaches a receiver without a vertex.

Emitters are sampled by their straight light in the light field, in the direction of the receiver.
The geometry is in the scene: a shadow ray decides whether the light arrives.

An element is a triangle, a disk, a cylinder or a sphere, or a part of one that is large or whose
radiance varies. A point of it is o + w₁ e₁ + w₂ e₂ + w₃ e₃, where the weights are of its kind.
Elements that are near each other are a cluster. A cluster is sampled first, and then an element of
it by its emission in a direction, so that few samples are on a side that is turned away.

Symbols
    F   elements of a surface before they are divided
    E   elements, in the order of their clusters        K   clusters
    R   bins of direction a side of the light field     B   bins of direction for elements
"""

from __future__ import annotations

import dataclasses
import math
from collections.abc import Callable, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.geometry import MeshArrays, Shape, UnitShape
from lumitree.asset.light_field import LightField, unpack
from lumitree.core.alias_table import AliasTable
from lumitree.core.device import on_device, parameter
from lumitree.core.octahedral import bin_of, middle_directions
from lumitree.lamp.emitting_surfaces import even_places
from lumitree.octree.build import morton
from lumitree.rendering.device_light import RECEIVERS, smooth_bin
from lumitree.rendering.light_table import ReceiverCells, cell_rows
from lumitree.rendering.sampling import STRAIGHT, Reservoir, Target, cosine_weight, scrambled

# Clusters at most, the depth of the finest grid whose cells they are, and how many are candidates.
_CLUSTERS, _DEPTH, _CANDIDATES = 16, 5, 2
# Least straight light, since light paths may have missed some: parts of the straight light around a
# direction, within the cosine, and of the light of unoccluded emitters. And part of the mean over
# all directions that is added to the unoccluded light.
_MISSED, _AROUND, _HARDLY, _ANYWHERE = 0.01, math.cos(math.radians(8)), 1e-9, 0.2
# Bins of direction a side, and entries of the table of elements by direction: lamps with more
# elements have fewer bins.
_BINS, _MAX_ENTRIES = 16, 1 << 21
# Part of the mean radiance of a surface that is added to each of its elements, since bright spots
# may lie between their points; and part of the mean intensity of an element over the sphere that is
# added in all directions, since the direction to a receiver differs within a cluster.
_FLOOR, _SPREAD = 0.2, 0.05


class StraightLight:
    """The emitters of a lamp.

    Args:
        surfaces: that emit, at least one.
        field: light field of the lamp; None if there is none.
        half_extents: of the lamp's box.
        factors: [3] factors on R, G and B.

    Attributes:
        densities: [N] of the surfaces: density per local area for weights of multiple importance
            sampling, the same for all points of a surface.
    """

    def __init__(
        self,
        surfaces: Sequence[EmittingSurface],
        field: LightField | None,
        half_extents: NDArray[np.float64],
        factors: tuple[float, float, float],
    ) -> None:
        self._elements, self._factors = Elements(surfaces), parameter(mi.Color3f, *factors)
        each, area = self._elements, self._elements.area
        self.densities, cluster = each.densities, each.cluster
        light = area[:, None] * (each.radiance + _FLOOR * each.surface_radiance[each.surface])
        weight = light.mean(axis=1)
        # Black ones have a direction, too.
        weight = np.maximum(weight, 1e-9 * weight.max() or 1.0)
        first = np.flatnonzero(np.diff(cluster, prepend=-1))
        self._first, self._bins = on_device(mi.UInt32, first), _BINS
        while self._bins > 1 and self._bins**2 * len(area) > _MAX_ENTRIES:
            self._bins //= 2
        sent = weight * (np.maximum(middle_directions(self._bins) @ each.normal.T, 0) + _SPREAD / 4)
        rows = np.split(sent, first[1:], axis=1)
        # A part for each cluster, with a row for each bin of direction.
        self._entries = AliasTable.of(*rows)

        flux = np.asarray(np.bincount(cluster, weight), np.float64)
        middles = np.stack([np.bincount(cluster, weight * x) for x in each.middle.T], axis=1)
        middles /= flux[:, None]
        low, high = (extreme.reduceat(each.middle, first) for extreme in (np.minimum, np.maximum))
        corners = on_device(mi.Float, np.stack([low, high], axis=1))
        size = ((high - low) ** 2).sum(axis=1) / 4
        self._middles = on_device(mi.Float, np.concatenate([middles, size[:, None]], axis=1))
        self._resolution = 8 if field is None else field.resolution
        bare = _bare(cluster, light @ np.array(factors), each.normal, self._resolution)
        outside = bare
        if field is not None:
            # For partly hidden emitters, the root mean square of samples, and not their mean.
            straight = _straight(field, middles, factors)
            outside = np.sqrt(np.maximum(straight, _missed(straight, bare)) * bare)
        # Intensities of clusters for receivers outside the box, and inside.
        self._intensity = on_device(mi.Float, np.stack([outside, bare]))
        self._clusters = parameter(mi.UInt32, len(flux))
        self._around = ReceiverCells(half_extents, *RECEIVERS)
        scale = parameter(mi.Float, max(float(outside.max()), 1e-30))
        self._table = AliasTable(*cell_rows(self._around, corners, self._towards, scale, flux))

    def _offset(self, x, cluster, active):
        """From the middle of a cluster to a receiver, and half its diagonal in square."""
        middle = dr.gather(mi.Vector4f, self._middles, cluster, active)
        return mi.Vector3f(x - mi.Point3f(middle.x, middle.y, middle.z)), middle.w

    def _towards(self, cluster, offset, _distance):
        """Intensity of a cluster for receivers outside the box, in a direction (mi.Vector3f)."""
        return mi.Color3f(self._sent(cluster, offset, mi.Bool(False), mi.Bool(True)))

    def _sent(self, cluster, offset, inside, active):
        """Radiant intensity of a cluster towards a receiver, about, summed over the channels."""
        index = dr.select(inside, self._clusters, 0) + cluster
        index = index * self._resolution**2 + smooth_bin(offset, self._resolution)
        return dr.gather(mi.Float, self._intensity, index, active)

    def choose(
        self,
        x: mi.Point3f,
        normal: mi.Vector3f,
        sample: mi.Point2f,
        target: Target,
        active: mi.Bool,
        inside: mi.Bool,
    ) -> None:
        """Let a target be one of straight light, with the probability of its part of the light.

        Resampled importance sampling among clusters, and then among the cluster and the point of
        stored light.

        Args:
            x: receiver, anywhere.
            normal, sample: as for the target.
            target: of stored light; changed. A `total` of 0 for straight light alone.
            inside: receivers in the box.
        """
        random = scrambled(mi.Point2f(1 - sample.x, sample.y))
        row = dr.select(inside, self._around.count, self._around.index(x))
        kept = mi.UInt32(0), mi.Float(1)
        reservoir = Reservoir.start(random.x, _CANDIDATES, random.y, kept)
        for _ in range(_CANDIDATES):
            cluster, pmf = self._table.sample(row, reservoir.place, active)
            offset, size = self._offset(x, cluster, active)
            light = self._sent(cluster, offset, inside, active)
            light *= cosine_weight(normal, -offset)
            light /= pmf * (dr.squared_norm(offset) + size)
            reservoir.add(light, (cluster, pmf))
        total = dr.select(active, reservoir.mean, 0)
        fraction = dr.select(total > 0, total / (total + target.total), 0)
        straight = random.z < fraction
        stored = target.factor / (1 - fraction)
        target.factor = dr.select(straight, reservoir.factor / fraction, stored)
        cluster, pmf = reservoir.kept
        target.cell = dr.select(straight, cluster, target.cell)
        target.pmf = dr.select(straight, pmf, target.pmf)
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
        entry, entry_pmf = self._entries.sample(bins, random.x, active, cluster)
        entry += dr.gather(mi.UInt32, self._first, cluster, active)
        found = self._elements.point(entry, place, active)
        offset = mi.Vector3f(found.p - x)
        squared = dr.squared_norm(offset)
        per_area = dr.abs(dr.dot(found.n, offset)) * dr.rsqrt(squared) / squared
        # As light paths do: on the side of the true normal, too.
        towards = dr.dot(found.n, offset) * dr.dot(found.n, found.facing)
        front = active & (dr.dot(found.facing, offset) < 0) & (towards < 0) & (per_area > 0)
        # Radiance over the density per steradian with which the point is sampled.
        light = self._factors * found.radiance * (per_area * found.area / entry_pmf)
        target.light = dr.select(front, light * (target.factor / target.pmf), 0)
        target.density = dr.select(front, found.density / per_area, 0)
        distance = dr.sqrt(squared)
        target.distance = dr.select(active, distance, target.distance)
        return offset / distance


def _clusters(middle: NDArray[np.float64]) -> NDArray[np.int64]:
    """Cluster [E] of each element by its middle [E, 3]."""
    depth = _DEPTH
    while True:
        side = 1 << depth
        cell = np.clip(np.floor((middle + 1) * (side / 2)), 0, side - 1).astype(np.int64)
        codes, cluster = np.unique(morton(cell), return_inverse=True)
        if len(codes) <= _CLUSTERS:
            return cluster
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
    field: LightField, middles: NDArray[np.float64], factors: tuple[float, float, float]
) -> NDArray[np.float64]:
    """Straight radiant intensity [K, R²] of clusters in a light field; `middles` [K, 3] of them."""
    straight = field.scale * (unpack(field.intensity) - unpack(field.bent)) @ np.array(factors)
    by_cell = field.dense(straight)
    centres = (field.cells + 0.5) * (2 / (1 << field.depth)) - 1
    nearest = np.stack([((centres - each) ** 2).sum(axis=1) for each in middles]).argmin(axis=0)
    return np.stack([by_cell[nearest == i].sum(axis=0) for i in range(len(middles))])


def _missed(straight: NDArray[np.float64], bare: NDArray[np.float64]) -> NDArray[np.float64]:
    """Least straight light [K, R²] of clusters, which light paths may have missed.

    A shade that is closed around a direction hides the emitters: sampling them would be for
    nothing.
    """
    directions = middle_directions(math.isqrt(straight.shape[1]))
    near = (directions @ directions.T >= _AROUND).astype(np.float64)
    around = (straight @ near) / np.maximum(bare @ near, 1e-300)
    return (_MISSED * around + _HARDLY) * bare


# Kinds of elements.
_FLAT, _DISK, _CYLINDER, _SPHERE = range(4)
_KINDS = {"disk": _DISK, "cylinder": _CYLINDER, "sphere": _SPHERE}
_RECTANGLE = np.array([[[-1, -1, 0], [1, -1, 0], [1, 1, 0]], [[-1, -1, 0], [1, 1, 0], [-1, 1, 0]]])
# Mitsuba's texture coordinates of the corners of a triangle that has none.
_BARYCENTRIC = np.array([[0, 0], [1, 0], [0, 1]])
# Side of an element, about, local units; and how many there are if surfaces are divided, about.
_SIDE, _ELEMENTS = 1 / 16, 1 << 15
# Parts of cylinders and spheres along both sides of the unit square, at least.
_CURVED = 8
# Points of each element at which a radiance that varies is evaluated.
_POINTS = 16
# Packets of four numbers of an element, and of values at its corners.
_PACKETS, _CORNERS = 5, 3

# Radiance at points of a surface, which uses `si.uv` alone.
Texture = Callable[["mi.SurfaceInteraction3f", "mi.Bool"], "mi.Color3f"]


@dataclasses.dataclass(frozen=True)
class EmittingSurface:
    """A shape of the geometry that emits, in the local frame.

    Attributes:
        frame: [F, 4, 3] o, e₁, e₂ and e₃ of its elements; e₃ of flat ones is the unit normal.
        kind: of its elements.
        inwards: whether normals of cylinders and spheres point inwards.
        radiance: [3]; or a texture.
        normals: [F, 3, 3] shading normals of the corners of triangles; None if they are flat.
        texcoords: [F, 3, 2] of their corners, if there is a texture.
    """

    frame: NDArray[np.float64]
    kind: int
    inwards: bool
    radiance: NDArray[np.float64] | Texture
    normals: NDArray[np.float64] | None = None
    texcoords: NDArray[np.float64] | None = None

    @property
    def areas(self) -> NDArray[np.float64]:
        """[F] of its elements."""
        first, second, third = (np.linalg.norm(self.frame[:, i], axis=1) for i in (1, 2, 3))
        across = np.linalg.norm(np.cross(self.frame[:, 1], self.frame[:, 2]), axis=1)
        if self.kind == _CYLINDER:
            return 2 * math.pi * first * third
        if self.kind == _SPHERE:
            return 4 * math.pi * first * second
        return across * (math.pi if self.kind == _DISK else 0.5)

    @property
    def varies(self) -> bool:
        """Whether its radiance differs from point to point."""
        return not isinstance(self.radiance, np.ndarray)


def emitting_surface(
    shape: Shape,
    mesh: MeshArrays | None,
    radiance: NDArray[np.float64] | Texture,
    matrix: NDArray[np.float64],
) -> EmittingSurface:
    """A surface of a shape of `AssetGeometry`; `matrix` [4, 4] leads to the local frame."""
    kind = _KINDS.get(shape.type, _FLAT) if isinstance(shape, UnitShape) else _FLAT
    corner: dict[str, Any] = {"normals": None, "texcoords": None}
    if isinstance(shape, UnitShape):
        matrix = matrix @ np.array(shape.to_world, np.float64)
    mirrored = mesh is None and np.linalg.det(matrix) < 0
    if kind != _FLAT:
        frame = np.concatenate([matrix[:3, 3:], matrix[:3, :3]], axis=1).T[None]
        if kind == _DISK:
            frame[:, 3] = np.cross(frame[:, 1], frame[:, 2]) * (-1 if mirrored else 1)
            frame[:, 3] /= np.linalg.norm(frame[:, 3]) * (-1 if shape.flipped else 1)
        # Mitsuba turns mirrored spheres inside out, and no mirrored cylinders.
        inwards = shape.flipped != (mirrored and kind == _SPHERE)
        return EmittingSurface(frame, kind, inwards, radiance)
    if mesh is None:
        corners = _RECTANGLE @ matrix[:3, :3].T + matrix[:3, 3]
        corner["texcoords"] = (_RECTANGLE[:, :, :2] + 1) / 2
    else:
        faces = mesh["faces"]
        corners = (mesh["vertices"] @ matrix[:3, :3].T + matrix[:3, 3])[faces]
        corner = {n: mesh[n][faces].astype(np.float64) if len(mesh[n]) else None for n in corner}
        if corner["normals"] is not None:
            sign = -1 if shape.flipped else 1
            corner["normals"] = sign * corner["normals"] @ matrix[:3, :3].T
    o, e1, e2 = corners[:, 0], corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0]
    normal = np.cross(e1, e2) * (-1 if shape.flipped != mirrored else 1)
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-300)
    return EmittingSurface(np.stack([o, e1, e2, normal], axis=1), kind, False, radiance, **corner)


@dataclasses.dataclass
class ElementPoint:
    """A point of an element, local units (a PyTree of Dr.Jit)."""

    # fmt: off
    p: mi.Point3f
    n: mi.Vector3f          # True normal
    facing: mi.Vector3f     # Shading normal, on whose side the element emits
    area: mi.Float          # Area of the element
    density: mi.Float       # See `Elements.densities`
    radiance: mi.Color3f
    # fmt: on


class Elements:
    """The elements of some surfaces, in the order of their clusters.

    Args:
        surfaces: at least one.

    Attributes:
        area: [E].
        cluster, surface: [E] index of the cluster and of the surface.
        radiance, surface_radiance: [E, 3] and [N, 3] mean radiance of the elements, and of the
            surfaces.
        middle, normal: [E, 3].
        densities: [N] of the surfaces: fraction of all emission over their area.
    """

    def __init__(self, surfaces: Sequence[EmittingSurface]) -> None:
        sides = _sides(surfaces)
        # These select the code of a kernel.
        self._textures = list[Texture]()
        self._kinds = {each.kind for each in surfaces}
        self._divided = any((each > 1).any() for each in sides)
        self._has_normals = any(each.normals is not None for each in surfaces)
        blocks = [self._block(*each) for each in zip(surfaces, sides, strict=True)]
        numbers = {name: np.concatenate([each[name] for each in blocks]) for name in blocks[0]}
        surface = np.repeat(np.arange(len(blocks)), [len(each["table"]) for each in blocks])
        # On the device in this order, for the middles; and then in the order of clusters.
        self._upload(numbers)
        entry, active = dr.arange(mi.UInt32, len(surface)), mi.Bool(True)
        middle = self.point(entry, mi.Point2f(0.5, 0.5), active)
        middles, normals = (np.array(each, np.float64).T for each in (middle.p, middle.n))
        cluster = _clusters(middles)
        order = np.argsort(cluster, kind="stable")
        self.cluster, self.surface = cluster[order], surface[order]
        self.middle, self.normal = middles[order], normals[order]
        table = numbers["table"]
        radiance = self._mean_radiance(len(table)) if self._textures else table[:, 4, :3]
        self.area, self.radiance = table[order, 0, 3], radiance[order]
        areas = np.maximum(np.bincount(self.surface, self.area), 1e-300)
        power = [np.bincount(self.surface, self.area * each) for each in self.radiance.T]
        self.surface_radiance = np.stack(power, axis=1) / areas[:, None]
        mean = self.surface_radiance.mean(axis=1)
        # Black surfaces are sampled too; their emission is 0.
        mean = mean if mean.any() else np.ones(len(mean))
        self.densities = mean / (mean * areas).sum()
        table[:, 4, 3] = self.densities[surface]
        self._upload({name: values[order] for name, values in numbers.items()})

    def point(self, entry: mi.UInt32, place: mi.Point2f, active: mi.Bool) -> ElementPoint:
        """A point of an element, uniform by area for a place in the unit square."""
        packets = [
            dr.gather(mi.Vector4f, self._elements, _PACKETS * entry + i, active)
            for i in range(_PACKETS)
        ]
        o, e1, e2, e3, colour = (mi.Vector3f(each.x, each.y, each.z) for each in packets)
        kind, piece, side = (mi.Int32(each.w) for each in packets[1:4])
        inwards, kind = kind < 0, dr.abs(kind) - 1
        if self._divided:
            row = piece // dr.maximum(side, 1)
            place += mi.Point2f(mi.Float(piece - row * side), mi.Float(row))
            place = dr.minimum(place / mi.Float(side), dr.one_minus_epsilon(mi.Float))
        weights = self._weights(kind, place)
        along = weights.x * e1 + weights.y * e2
        point, normal = o + along, e3
        if self._kinds & {_CYLINDER, _SPHERE}:
            curved = (kind == _CYLINDER) | (kind == _SPHERE)
            point += dr.select(curved, weights.z, 0) * e3
            along += dr.select(kind == _SPHERE, weights.z, 0) * e3
            along = dr.normalize(dr.select(inwards, -along, along))
            normal = dr.select(curved, along, normal)
        facing, radiance = mi.Vector3f(normal), mi.Color3f(colour)
        corners = 1 - weights.x - weights.y, weights.x, weights.y
        if self._has_normals:
            shading = self._at_corners(self._normals, entry, corners, active)
            facing = dr.select(kind == _FLAT, shading, facing)
        if self._textures:
            uv = self._at_corners(self._texcoords, entry, corners, active)
            texture = mi.UInt32(dr.gather(mi.Float, self._texcoords, 12 * entry + 3, active))
            si = dr.zeros(mi.SurfaceInteraction3f, dr.width(entry))
            si.uv = dr.select(kind == _FLAT, mi.Point2f(uv.x, uv.y), _coordinates(kind, weights))
            calls = [lambda si, on, given: given]
            calls += [
                lambda si, on, given, each=each: mi.Color3f(each(si, on)) for each in self._textures
            ]
            radiance = dr.switch(texture, calls, si, mi.Bool(active), radiance)
        return ElementPoint(
            mi.Point3f(point), mi.Vector3f(normal), facing, packets[0].w, packets[4].w, radiance
        )

    def _weights(self, kind: mi.Int32, place: mi.Point2f) -> mi.Vector3f:
        """The weights of a point of an element, uniform by area for a place in the unit square."""
        triangle = mi.warp.square_to_uniform_triangle(place)
        weights = mi.Vector3f(triangle.x, triangle.y, 0)
        if _DISK in self._kinds:
            disk = mi.warp.square_to_uniform_disk_concentric(place)
            weights = dr.select(kind == _DISK, mi.Vector3f(disk.x, disk.y, 0), weights)
        if _CYLINDER in self._kinds:
            sine, cosine = dr.sincos(2 * math.pi * place.x)
            weights = dr.select(kind == _CYLINDER, mi.Vector3f(cosine, sine, place.y), weights)
        if _SPHERE in self._kinds:
            sphere = mi.warp.square_to_uniform_sphere(place)
            weights = dr.select(kind == _SPHERE, mi.Vector3f(sphere), weights)
        return weights

    def _at_corners(self, table, entry, weights, active):
        """Values that are linear between the corners of triangles (mi.Vector3f)."""
        total = mi.Vector3f(0)
        for corner, weight in enumerate(weights):
            packet = dr.gather(mi.Vector4f, table, _CORNERS * entry + corner, active)
            total += weight * mi.Vector3f(packet.x, packet.y, packet.z)
        return total

    def _block(
        self, surface: EmittingSurface, side: NDArray[np.int64]
    ) -> dict[str, NDArray[np.float64]]:
        """Numbers of the elements of a surface [F], each divided into side² pieces."""
        count = len(surface.frame)
        table = np.zeros((count, _PACKETS, 4))
        table[:, :4, :3], table[:, 0, 3] = surface.frame, surface.areas / side**2
        table[:, 1, 3] = (surface.kind + 1) * (-1 if surface.inwards else 1)
        table[:, 3, 3] = side
        normals, texcoords = np.zeros((2, count, _CORNERS, 4))
        normals[..., :3] = surface.frame[:, None, 3] if surface.normals is None else surface.normals
        if isinstance(surface.radiance, np.ndarray):
            table[:, 4, :3] = surface.radiance
        else:
            self._textures.append(surface.radiance)
            texcoords[:, 0, 3] = len(self._textures)
            given = surface.texcoords
            texcoords[..., :2] = _BARYCENTRIC if given is None else given
        numbers = {"table": table, "normals": normals, "texcoords": texcoords}
        pieces = side**2
        numbers = {name: np.repeat(each, pieces, axis=0) for name, each in numbers.items()}
        first = np.repeat(np.cumsum(pieces) - pieces, pieces)
        numbers["table"][:, 2, 3] = np.arange(len(first)) - first
        return numbers

    def _upload(self, numbers: dict[str, NDArray[np.float64]]) -> None:
        self._elements = on_device(mi.Float, numbers["table"])
        self._normals = on_device(mi.Float, numbers["normals"]) if self._has_normals else None
        self._texcoords = on_device(mi.Float, numbers["texcoords"]) if self._textures else None

    def _mean_radiance(self, count: int) -> NDArray[np.float64]:
        """[E, 3] mean over some points of each element."""
        entry, number = dr.meshgrid(dr.arange(mi.UInt32, count), dr.arange(mi.UInt32, _POINTS))
        radiance = self.point(entry, even_places(number), mi.Bool(True)).radiance
        found = np.array(radiance, np.float64).T.reshape(_POINTS, count, 3).mean(axis=0)
        return np.maximum(np.nan_to_num(found), 0)


def _coordinates(kind: mi.Int32, weights: mi.Vector3f) -> mi.Point2f:
    """Texture coordinates of a point of a primitive, as Mitsuba has them."""
    turn = dr.atan2(weights.y, weights.x) * dr.inv_two_pi
    turn = dr.select(turn < 0, turn + 1, turn)
    radius = dr.norm(mi.Vector2f(weights.x, weights.y))
    uv = dr.select(kind == _DISK, mi.Point2f(radius, turn), mi.Point2f(turn, weights.z))
    return dr.select(kind == _SPHERE, mi.Point2f(turn, dr.safe_acos(weights.z) / dr.pi), uv)


def _sides(surfaces: Sequence[EmittingSurface]) -> list[NDArray[np.int64]]:
    """Parts [F] along both sides of the unit square of the elements of each surface."""
    varying = sum(len(each.frame) for each in surfaces if each.varies)
    finest = max(math.isqrt(_ELEMENTS // max(varying, 1)), 1)
    wanted = []
    for each in surfaces:
        least = max(finest if each.varies else 1, 1 if each.kind in (_FLAT, _DISK) else _CURVED)
        wanted.append(np.maximum(np.sqrt(each.areas) / _SIDE, least))
    total = sum((each**2).sum() for each in wanted)
    less = min(1.0, math.sqrt(_ELEMENTS / total))
    return [np.maximum(np.ceil(less * each), 1).astype(np.int64) for each in wanted]
