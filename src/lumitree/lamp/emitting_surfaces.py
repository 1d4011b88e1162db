"""The surfaces that emit: triangles of meshes, and spheres, disks and cylinders as a whole.

Light starts on surfaces, not in images: a triangle or primitive is chosen in proportion to its area
times its mean radiance, a point is sampled uniformly by area, and the radiance is evaluated there.
Where the radiance varies, large triangles and primitives are divided into cells of equal area.
Mitsuba samples the pixels of a texture instead, which is right only where the texture
coordinates of a shape cover the unit square exactly once.

Symbols
    pmf       probability of a cell: a triangle or primitive, or a part of one
    side      cells of a triangle or primitive along both sides of the unit square, which is mapped
              to it with equal areas
    density   of a point, per unit of area: pmf / area

Area emitters with a texture are replaced by `lumitree_area`, which samples so, in scenes that are
loaded.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.alias_table import AliasTable
from lumitree.core.device import channel_mean, on_device
from lumitree.core.mitsuba_meshes import mesh_triangles
from lumitree.lamp.scene_shapes import referred

# Cells of all surfaces with varying radiance, at most but for one each.
_CELLS = 1 << 19
# Points at which the radiance of all cells is evaluated for their means, about, and at least and at
# most for each. Their offset keeps them off the edges.
_POINTS, _FEWEST, _MOST = 1 << 18, 8, 1 << 10
# Parts of the largest mean of the cells around a cell, and of the mean of its shape, that are added
# to its own: the edges of a bright spot, and small spots, may lie between the points.
_AROUND, _FLOOR = 0.2, 0.05

# Wavelengths at which it is evaluated in spectral variants, nm.
_WAVELENGTHS = (450.0, 530.0, 590.0, 650.0)
_PLUGIN = "lumitree_area"
# Radiance that is everywhere the same. Mitsuba's own emitter samples such surfaces by area, and
# takes the PDF by solid angle from shading normals: one for each of many filaments would take long.
_CONSTANT = ("d65", "irregular", "regular", "srgb", "uniform")
# The class of the emitter in each variant in which it is registered.
_classes: dict[str | None, type] = {}


@dataclass
class SurfacePoint:
    """A point that was sampled (a PyTree of Dr.Jit)."""

    # fmt: off
    si: mi.SurfaceInteraction3f  # As a ray that hits the point along -n has it
    density: mi.Float            # Probability per unit of area; 0 where nothing was sampled
    index: mi.UInt32             # of the shape
    emitter: mi.EmitterPtr
    # fmt: on

    def towards(self, it: mi.Interaction3f) -> tuple[mi.DirectionSample3f, mi.Float]:
        """Direction from a vertex to the point, whose `si.wi` is turned to the vertex; and its PDF.

        `DirectionSample3f.pdf` is left for the caller: `pdf_direction` does not depend on the
        triangle, so weights of multiple importance sampling use another density, on both sides.
        They add up to 1 with any.
        """
        ds, si = dr.zeros(mi.DirectionSample3f), self.si
        ds.p, ds.n, ds.uv, ds.time = si.p, si.sh_frame.n, si.uv, it.time
        ds.d = si.p - it.p
        ds.dist = dr.norm(ds.d)
        ds.d /= ds.dist
        ds.emitter = self.emitter
        si.wi, si.wavelengths = si.to_local(-ds.d), it.wavelengths
        cosine = dr.abs(dr.dot(ds.d, si.n))
        return ds, dr.select(cosine > 0, self.density * dr.square(ds.dist) / cosine, 0)


class EmittingSurfaces:
    """Sampling of points of shapes that emit.

    Shapes are referred to by pointers, which do not keep them alive.

    Args:
        shapes: meshes and primitives, each with an emitter.
        radiance: function of points, and of the index of the shape of each, that returns what they
            emit towards `si.wi`.

    Attributes:
        power: area times mean radiance of all, averaged over the channels.
    """

    def __init__(
        self,
        shapes: Sequence[mi.Shape],
        radiance: Callable[[mi.SurfaceInteraction3f, mi.UInt32], mi.Spectrum],
    ) -> None:
        areas = [_areas(shape) for shape in shapes]
        side = _sides(shapes, [len(each) for each in areas])
        areas = [np.repeat(a / n**2, n**2) for a, n in zip(areas, side, strict=True)]
        counts = np.array([len(each) for each in areas])
        area, shape_of = np.concatenate(areas), np.repeat(np.arange(len(shapes)), counts)
        first = np.cumsum(counts) - counts
        self._shapes = mi.ShapePtr(list(shapes))
        self._emitters = mi.EmitterPtr([shape.emitter() for shape in shapes])
        self._primitives = frozenset(s.emitter().ptr for s in shapes if not s.is_mesh())
        self._shape_of = on_device(mi.UInt32, shape_of)
        # Whether a triangle or primitive is one of a mesh, by the shape.
        self._is_mesh = on_device(mi.Bool, [shape.is_mesh() for shape in shapes])
        self._first, self._side = on_device(mi.UInt32, first), on_device(mi.UInt32, side)
        mean = self._mean_radiance(radiance)
        power = np.bincount(shape_of, area * mean, len(shapes))
        floor = _FLOOR * power / np.maximum(np.add.reduceat(area, first), 1e-300)
        around = [
            _largest_around(mean[i : i + c], n) for i, c, n in zip(first, counts, side, strict=True)
        ]
        weight = area * (mean + _AROUND * np.concatenate(around) + floor[shape_of])
        self.power = float(power.sum())
        # Black shapes are sampled too, and what they emit is 0.
        used = weight if weight.sum() > 0 else area
        self._table = AliasTable.of(used[None])
        self._area = on_device(mi.Float, area)

    def sample(self, sample: mi.Point2f, active: mi.Bool | bool = True) -> SurfacePoint:
        """Sample a point; `sample` is in the unit square."""
        x, y, u, v = four_numbers(sample)
        entry, pmf = self._table.sample(mi.UInt32(0), x, active, other=y)
        area = dr.gather(mi.Float, self._area, entry, active)
        density = dr.select(area > 0, pmf / area, 0)
        si, index = self._point(entry, mi.Point2f(u, v), active & (density > 0))
        emitter = dr.gather(mi.EmitterPtr, self._emitters, index, active)
        return SurfacePoint(si, dr.select(si.is_valid(), density, 0), index, emitter)

    def _point(
        self, entry: mi.UInt32, place: mi.Point2f, active: mi.Bool | bool
    ) -> tuple[mi.SurfaceInteraction3f, mi.UInt32]:
        """A point of a cell, and the index of the shape."""
        index = dr.gather(mi.UInt32, self._shape_of, entry, active)
        side = dr.gather(mi.UInt32, self._side, index, active)
        number = entry - dr.gather(mi.UInt32, self._first, index, active)
        prim_index = number // dr.maximum(side * side, 1)
        cell = number - prim_index * side * side
        row = cell // dr.maximum(side, 1)
        corner = mi.Point2f(mi.Float(cell - row * side), mi.Float(row))
        place = dr.minimum((corner + place) / mi.Float(side), dr.one_minus_epsilon(mi.Float))
        pi = dr.zeros(mi.PreliminaryIntersection3f, dr.width(entry))
        pi.shape = dr.gather(mi.ShapePtr, self._shapes, index, active)
        pi.prim_index = prim_index
        pi.prim_uv = mi.warp.square_to_uniform_triangle(place)
        pi.t, pi.valid = mi.Float(1), mi.Bool(active)
        ray = mi.Ray3f(mi.Point3f(0), mi.Vector3f(0, 0, 1))
        if self._primitives:
            emitter = dr.gather(mi.EmitterPtr, self._emitters, index, active)
            on_mesh = dr.gather(mi.Bool, self._is_mesh, index, active)
            o, d, t, uv = dr.dispatch(emitter, self._on_primitive, place, active & ~on_mesh)
            ray.o, ray.d = dr.select(on_mesh, ray.o, o), dr.select(on_mesh, ray.d, d)
            pi.t, pi.prim_uv = dr.select(on_mesh, pi.t, t), dr.select(on_mesh, pi.prim_uv, uv)
            pi.valid &= on_mesh | (t < dr.inf)
        si = pi.compute_surface_interaction(ray, mi.RayFlags.All, active)
        si.wi = si.to_local(si.n)
        return si, index

    def _on_primitive(
        self, emitter: mi.Emitter, place: mi.Point2f, active: mi.Bool
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Float, mi.Point2f]:
        """A ray that hits a sampled point of an emitter's primitive; its t and `prim_uv` there."""
        # Dr.Jit records this for all emitters of the process, which may have any shape.
        if emitter.ptr not in self._primitives:
            return mi.Point3f(0), mi.Vector3f(0, 0, 1), mi.Float(dr.inf), mi.Point2f(0)
        shape = emitter.get_shape()
        point = shape.sample_position(0, place, active)
        # From so near that no other part of the primitive is in between.
        distance = dr.maximum(1e-3 * dr.sqrt(shape.surface_area()), 1e-6 * dr.max(dr.abs(point.p)))
        ray = mi.Ray3f(point.p + distance * point.n, -mi.Vector3f(point.n))
        pi = shape.ray_intersect_preliminary(ray, active=active)
        return ray.o, ray.d, pi.t, pi.prim_uv

    def _mean_radiance(
        self, radiance: Callable[[mi.SurfaceInteraction3f, mi.UInt32], mi.Spectrum]
    ) -> NDArray[np.float64]:
        """Mean over the channels and over some points of each cell."""
        count = dr.width(self._shape_of)
        points = int(np.clip(_POINTS // count, _FEWEST, _MOST))
        entry, number = dr.meshgrid(dr.arange(mi.UInt32, count), dr.arange(mi.UInt32, points))
        si, index = self._point(entry, even_places(number), mi.Bool(True))
        # Along the shading normal, which decides whether a surface emits.
        si.wi = mi.Vector3f(0, 0, 1)
        if mi.is_spectral:
            si.wavelengths = type(si.wavelengths)(*_WAVELENGTHS)
        values = channel_mean(radiance(si, index))
        found = np.array(dr.select(si.is_valid(), values, 0), np.float64)
        return np.maximum(found.reshape(points, count).mean(axis=0), 0)


def even_places(number: mi.UInt32) -> mi.Point2f:
    """Places of a number each that cover the unit square evenly: an additive recurrence.

    Roberts 2018.
    """
    place = mi.Point2f(0.7548776662466927, 0.5698402909980532) * (mi.Float(number) + 0.5)
    return place - dr.floor(place)


def emitting_surfaces(scene: mi.Scene) -> EmittingSurfaces:
    """The surfaces of all emitters of a scene, whose index is the emitter's in the scene."""
    emitters = scene.emitters_dr()

    def radiance(si: mi.SurfaceInteraction3f, index: mi.UInt32) -> mi.Spectrum:
        return dr.gather(mi.EmitterPtr, emitters, index).eval(si)

    # An emitter returns its shape without the class that has the vertices of a mesh.
    shape_of = {shape.emitter(): shape for shape in scene.shapes() if shape.is_emitter()}
    return EmittingSurfaces([shape_of[each] for each in scene.emitters()], radiance)


def _sides(shapes: Sequence[mi.Shape], counts: Sequence[int]) -> NDArray[np.int64]:
    """Side of the triangles or primitives of each shape, by their numbers."""
    flag = int(mi.EmitterFlags.SpatiallyVarying)
    varies = np.array([bool(int(shape.emitter().flags()) & flag) for shape in shapes])
    side = math.isqrt(_CELLS // max(int(np.sum(counts, where=varies)), 1))
    return np.where(varies, max(side, 1), 1)


def _largest_around(mean: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Largest mean of each cell of one shape and of its neighbours; 0 where there are none."""
    if side == 1:
        return np.zeros_like(mean)
    # Few lamps need it, and it takes as long to import as all else here.
    from scipy.ndimage import maximum_filter

    return maximum_filter(mean.reshape(-1, side, side), (1, 3, 3)).ravel()


def four_numbers(sample: mi.Point2f) -> tuple[mi.Float, mi.Float, mi.Float, mi.Float]:
    """Numbers in [0, 1) from all bits of a sample in the unit square."""
    x, y = (dr.reinterpret_array(mi.UInt32, each) for each in (sample.x, sample.y))
    first = mi.sample_tea_32(x, y)
    second = mi.sample_tea_32(first[1], first[0])
    a, b, c, d = (mi.Float(word >> 8) * 2.0**-24 for word in (*first, *second))
    return a, b, c, d


def _outwards(si: mi.SurfaceInteraction3f) -> mi.Vector3f:
    """The true normal, on the side of the shading normal: of mirrored shapes it is not."""
    return mi.Vector3f(dr.mulsign(si.n, dr.dot(si.n, si.sh_frame.n)))


def _areas(shape: mi.Shape) -> NDArray[np.float64]:
    """Areas of the triangles [F] of a mesh; [1] of a primitive."""
    if not isinstance(shape, mi.Mesh):
        return np.array(shape.surface_area(), np.float64).ravel()
    corners = mesh_triangles(shape)
    return np.linalg.norm(np.cross(*np.moveaxis(corners[:, 1:] - corners[:, :1], 1, 0)), axis=1) / 2


def replace_textured_areas(state: mi.parser.ParserState) -> None:
    """Let area emitters with a texture in a mi.parser.ParserState be emitters `lumitree_area`."""
    for node in state.nodes:
        props = node.props
        if node.type == mi.ObjectType.Emitter and props.plugin_name() == "area":
            textures = (state.nodes[index].props for index in referred(props).values())
            if any(each.plugin_name() not in _CONSTANT for each in textures):
                if mi.variant() not in _classes:
                    _classes[mi.variant()] = _emitter_class()
                    mi.register_emitter(_PLUGIN, _classes[mi.variant()])
                props.set_plugin_name(_PLUGIN)


def complete_textured_areas(scene: mi.Scene) -> None:
    """Make the tables of a scene's emitters `lumitree_area`, before a kernel uses them."""
    kind = _classes.get(mi.variant())
    for shape in scene.shapes():
        if kind is not None and isinstance(emitter := shape.emitter(), kind):
            emitter.complete(shape)


def _emitter_class() -> type:
    """Class of the emitter for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeArea(mi.Emitter):
        """`area`, sampled as `EmittingSurfaces` samples."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self._radiance = props.get_emissive_texture("radiance")
            # Without, as in a scene that could not be created, nothing is sampled.
            self._surfaces: EmittingSurfaces | None = None
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def complete(self, shape: mi.Shape) -> None:
            self._surfaces = EmittingSurfaces([shape], lambda si, _: self.eval(si))

        def eval(self, si, active=True):
            # On the front by both normals, as light paths leave it.
            front = mi.Frame3f.cos_theta(si.wi) > 0
            front &= dr.dot(si.to_world(si.wi), _outwards(si)) > 0
            return dr.select(front, self._radiance.eval(si, active & front), 0)

        def sample_direction(self, it, sample, active=True):
            if self._surfaces is None:
                return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0)
            point = self._surfaces.sample(sample, active)
            ds, pdf = point.towards(it)
            weight = dr.select(pdf > 0, self.eval(point.si, active) / pdf, 0)
            ds.pdf = dr.select(dr.max(weight) > 0, self.pdf_direction(it, ds, active), 0)
            return ds, weight

        def pdf_direction(self, it, ds, active=True):
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            return dr.select(facing, self.get_shape().pdf_direction(it, ds, facing), 0)

        def eval_direction(self, it, ds, active=True):
            si = mi.SurfaceInteraction3f(ds, it.wavelengths)
            si.wi = mi.Vector3f(0, 0, -dr.dot(ds.d, ds.n))
            return self.eval(si, active)

        def sample_wavelengths(self, si, sample, active=True):
            if not mi.is_spectral:
                return mi.Color0f(), self.eval(si, active)
            shifts = [sample + i / dr.size_v(mi.Spectrum) for i in range(dr.size_v(mi.Spectrum))]
            return self._radiance.sample_spectrum(
                si, mi.Spectrum([each - dr.floor(each) for each in shifts]), active
            )

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            if self._surfaces is None:
                return dr.zeros(mi.Ray3f), mi.Spectrum(0)
            point = self._surfaces.sample(sample2, active)
            si, local = point.si, mi.warp.square_to_cosine_hemisphere(sample3)
            # About the true normal, and on the side of the shading normal.
            direction = mi.Frame3f(_outwards(si)).to_world(local)
            si.wi, si.time = si.to_local(direction), time
            si.wavelengths, weight = self.sample_wavelengths(si, sample1, active)
            emits = (point.density > 0) & (mi.Frame3f.cos_theta(si.wi) > 0)
            return si.spawn_ray(direction), dr.select(emits, weight * dr.pi / point.density, 0)

        def sample_position(self, time, sample, active=True):
            # For light tracing, where it connects the surface with the camera.
            ps = self.get_shape().sample_position(time, sample, active)
            return ps, dr.select(ps.pdf > 0, dr.rcp(ps.pdf), 0)

        def traverse(self, callback):
            callback.put("radiance", self._radiance, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"LumitreeArea[radiance={self._radiance}]"

    return LumitreeArea
