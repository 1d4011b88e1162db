"""Detection of glass that Mitsuba renders wrongly: nested, touching, inside out, or not closed.

Mitsuba does not track which media a path is inside of. Each dielectric surface defines the indices
of refraction on its two sides. Solid glass must therefore be closed, and no two bodies may overlap
or touch.

The check computes all crossings of straight lines, along three directions, with the dielectric
shapes. Definitions, for one crossing of a line with a surface:

    step      +1 where the line enters the denser side, -1 where it leaves it
    depth     sum of the steps so far; in correct geometry 0 outside of glass and 1 inside

Unlike by Mitsuba's rays, triangles are intersected in double precision, and no crossing is missed
because it is close to another one.
"""

from __future__ import annotations

import dataclasses
import importlib
import itertools
import warnings
from collections.abc import Iterable, Iterator, Sequence
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.core.device import on_device
from lumitree.core.frames import rotation
from lumitree.core.mitsuba_meshes import is_flipped, mesh_arrays
from lumitree.errors import LumitreeWarning
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.meshes import Floats

if TYPE_CHECKING:
    import mitsuba as mi

Indices = NDArray[np.int64]

# Largest number of lines per side of the square grid in each direction. The grid is coarser where
# more pairs of a line and a triangle than _MAX_CANDIDATES would have to be tested.
_MAX_GRID = 256
_MAX_CANDIDATES = 500_000
# Mitsuba offsets the origin of a ray from a surface by this length, times 1 + the largest
# coordinate.
_RAY_EPSILON = 1500 * 2.0**-24
# Largest number of lines whose crossings are examined one by one.
_MAX_EXAMINED = 2000
# Smallest cosine between the normals of surfaces that touch.
_PARALLEL = 0.9
# Two surfaces that touch in a smaller fraction of a shape's crossings only share a sharp edge.
_MIN_SHARE = 0.01
# Largest number of warnings per luminaire.
_MAX_WARNED = 5


@dataclasses.dataclass(frozen=True)
class Crossings:
    """Crossings of lines with surfaces, in order along each line.

    Attributes:
        line: [N] index of the line.
        shape: [N] index of the shape.
        distance: [N] distance along the line, scene units.
        normal: [N, 3] geometric normal, pointing out of the glass.
        direction: [N, 3] direction of the line.
        offset: [N] distance by which Mitsuba offsets a ray's origin from this surface, scene
            units.
    """

    line: Indices
    shape: Indices
    distance: Floats
    normal: Floats
    direction: Floats
    offset: Floats

    @property
    def step(self) -> Indices:
        """[N] +1 where the line enters the glass, -1 where it leaves it."""
        return np.where((self.normal * self.direction).sum(axis=1) < 0, 1, -1)

    def take(self, index: NDArray) -> Crossings:
        """The crossings at `index`, which may be a mask."""
        return Crossings(*(value[index] for value in vars(self).values()))


def trace_lines(shapes: Sequence[mi.Shape]) -> Crossings:
    """Crossings with the surfaces of refracting shapes, along three directions that are no axes."""
    meshes = {i: _triangles(shape) for i, shape in enumerate(shapes) if shape.is_mesh()}
    sides = [_denser_side(shape) for shape in shapes]
    # Lines along the axes would often be parallel to faces, or meet edges.
    turn = rotation([0.36, 0.48, 0.8], 40.0)
    pieces = []
    for number in range(3):
        frame = np.roll(turn, number, axis=1)
        turned = {i: corners @ frame for i, (corners, _) in meshes.items()}
        points = [corners.reshape(-1, 3) for corners in turned.values()]
        for i, shape in enumerate(shapes):
            if i not in meshes:
                box = zip(np.ravel(shape.bbox().min), np.ravel(shape.bbox().max), strict=True)
                points.append(np.array(list(itertools.product(*box)), np.float64) @ frame)
        grid = _Grid.over(number, frame, np.concatenate(points), turned.values())
        for i, shape in enumerate(shapes):
            if i in meshes:
                line, distance, face = grid.cross_triangles(turned[i])
                normal = sides[i] * meshes[i][1][face]
                pieces.append(grid.crossings(line, i, distance, normal))
            else:
                pieces += [
                    grid.crossings(line, i, distance, sides[i] * normal)
                    for line, distance, normal in grid.cross_shape(shape)
                ]
    columns = zip(*(vars(piece).values() for piece in pieces), strict=True)
    together = Crossings(*(np.concatenate(column) for column in columns))
    return together.take(np.lexsort((together.distance, together.line)))


def _denser_side(shape: mi.Shape) -> int:
    """+1 if the normal points out of the denser medium, else -1."""
    # Only what is needed is read: Mitsuba cannot return some parameters of other plugins.
    parameters = load_mitsuba().traverse(shape.bsdf())
    names = [name for name in parameters.keys() if name.endswith("eta")]  # noqa: SIM118
    eta = [np.ravel(parameters[name])[0] for name in names]
    return -1 if eta and eta[0] < 1 else 1


def _triangles(shape: mi.Shape) -> tuple[Floats, Floats]:
    """Corners [F, 3, 3] of a mi.Mesh in double precision, and unit normals [F, 3] of its faces.

    The normals are on the same side as Mitsuba's shading normals.
    """
    arrays = mesh_arrays(shape)
    corners = arrays["vertices"].astype(np.float64)[arrays["faces"]]
    normals = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-300)
    if "normals" in arrays:
        mean = arrays["normals"].astype(np.float64)[arrays["faces"]].sum(axis=1)
        normals[(normals * mean).sum(axis=1) < 0] *= -1
    return corners, -normals if is_flipped(shape) else normals


@dataclasses.dataclass(frozen=True)
class _Grid:
    """Parallel lines along the third axis of a frame, through a lattice in the first two axes.

    Attributes:
        first_line: index of its first line.
        frame: [3, 3] matrix whose columns are the axes.
        low: [2] first point of the lattice.
        spacing: distance of neighbouring lines.
        count: numbers of lines along the first and the second axis.
        start: third coordinate of a plane in front of all shapes.
    """

    first_line: int
    frame: Floats
    low: Floats
    spacing: float
    count: tuple[int, int]
    start: float

    @staticmethod
    def over(number: int, frame: Floats, points: Floats, meshes: Iterable[Floats]) -> _Grid:
        """Grid that covers points [N, 3]; points and triangles are in coordinates of `frame`."""
        low, extent = points.min(axis=0), np.ptp(points, axis=0)
        area = sum(float(np.ptp(corners[..., :2], axis=1).prod(axis=1).sum()) for corners in meshes)
        spacing = max(float(extent[:2].max()) / _MAX_GRID, (area / _MAX_CANDIDATES) ** 0.5)
        columns, rows = (max(1, int(n)) for n in extent[:2] / spacing)
        start = float(low[2] - extent.max())
        first_line = number * _MAX_GRID**2
        return _Grid(first_line, frame, low[:2] + spacing / 2, spacing, (columns, rows), start)

    def crossings(self, line: Indices, shape: int, distance: Floats, normal: Floats) -> Crossings:
        """Crossings with one shape, from the results of `cross_triangles` or `cross_shape`."""
        points = self._points(line, distance)
        return Crossings(
            line + self.first_line,
            np.full(len(line), shape),
            distance,
            normal,
            np.broadcast_to(self.frame[:, 2], normal.shape),
            _RAY_EPSILON * (1 + np.abs(points).max(axis=1, initial=0)),
        )

    def cross_triangles(self, corners: Floats) -> tuple[Indices, Floats, Indices]:
        """Line [N], distance [N] and face [N] of crossings with triangles in the grid's frame."""
        low, high = corners[..., :2].min(axis=1), corners[..., :2].max(axis=1)
        first = np.maximum(np.ceil((low - self.low) / self.spacing).astype(np.int64), 0)
        last = np.floor((high - self.low) / self.spacing).astype(np.int64)
        size = np.maximum(np.minimum(last, np.array(self.count) - 1) - first + 1, 0)
        # Candidates are the lines within a triangle's box; they are then tested with the triangle.
        candidates = size[:, 0] * size[:, 1]
        face = np.repeat(np.arange(len(candidates)), candidates)
        within = np.arange(len(face)) - (np.cumsum(candidates) - candidates)[face]
        column = first[face, 0] + within % size[face, 0]
        row = first[face, 1] + within // size[face, 0]
        x, y = (self.low[k] + self.spacing * index for k, index in enumerate((column, row)))
        a, b, c = np.moveaxis(corners[face], 1, 0)
        weights = np.stack([_area(b, c, x, y), _area(c, a, x, y), _area(a, b, x, y)])
        inside = (weights > 0).all(axis=0) | (weights < 0).all(axis=0)
        distance = (weights * np.stack([a[:, 2], b[:, 2], c[:, 2]])).sum(axis=0)[inside]
        distance /= weights.sum(axis=0)[inside]
        return (column + self.count[0] * row)[inside], distance, face[inside]

    def cross_shape(self, shape: mi.Shape) -> Iterator[tuple[Indices, Floats, Floats]]:
        """Line [N], distance [N] and normal [N, 3] of crossings with a shape that is not a mesh."""
        mi, dr = load_mitsuba(), importlib.import_module("drjit")
        line = np.arange(self.count[0] * self.count[1])
        direction = mi.Vector3f(self.frame[:, 2])
        # One kernel for all directions.
        dr.make_opaque(direction)
        start = self._points(line, np.full(len(line), self.start))
        while len(line):
            si = shape.ray_intersect(mi.Ray3f(on_device(mi.Point3f, start), direction))
            valid = si.is_valid()
            dr.eval(valid, si.p, si.n)
            hit = np.array(valid)
            point, normal = (np.array(vector, np.float64).T[hit] for vector in (si.p, si.n))
            line = line[hit]
            yield line, point @ self.frame[:, 2], normal
            # Continue behind this surface. No other shape is missed: each is intersected by itself.
            step = 2 * _RAY_EPSILON * (1 + np.abs(point).max(initial=0))
            start = point + step * self.frame[:, 2]

    def _points(self, line: Indices, distance: Floats) -> Floats:
        """World positions [N, 3] on lines."""
        row, column = np.divmod(line, self.count[0])
        lattice = self.low + self.spacing * np.column_stack([column, row])
        return np.column_stack([lattice, distance]) @ self.frame.T


def _area(a: Floats, b: Floats, x: Floats, y: Floats) -> Floats:
    """Twice the signed area [N] of triangles (a, b, (x, y)) in the first two coordinates."""
    return (b[:, 0] - a[:, 0]) * (y - a[:, 1]) - (b[:, 1] - a[:, 1]) * (x - a[:, 0])


def warn_of_faults(luminaire: Luminaire) -> list[str]:
    """Warn of glass that cannot be rendered correctly; returns one line per fault."""
    faults = diagnose(luminaire.scene)
    for fault in faults[:_MAX_WARNED]:
        warnings.warn(f"{luminaire.name}: {fault}", LumitreeWarning, stacklevel=3)
    if len(faults) > _MAX_WARNED:
        more = f"{luminaire.name}: {len(faults) - _MAX_WARNED} more faults of this kind"
        warnings.warn(more, LumitreeWarning, stacklevel=3)
    return faults


def diagnose(scene: mi.Scene) -> list[str]:
    """Faults of a scene's glass.

    A fault that is smaller than the spacing of the lines (1/256 of the extent of the glass) may be
    missed. Instances and shapes behind null surfaces are not examined.

    Args:
        scene: mi.Scene.

    Returns:
        One line of text for each fault; empty if none was found.
    """
    shapes = [shape for shape in scene.shapes() if _is_dielectric(shape)]
    if not shapes:
        return []
    names = [repr(s.id()) if s.id() else f"an unnamed {s.class_name().lower()}" for s in shapes]
    crossings = trace_lines(shapes)
    # A line enters open shapes more or less often than it leaves them.
    key, index = np.unique(crossings.line * len(shapes) + crossings.shape, return_inverse=True)
    balance = np.bincount(index, crossings.step, len(key))
    open_shapes = np.unique(key[np.abs(balance) > 0.5] % len(shapes))
    closed = crossings.take(~np.isin(crossings.shape, open_shapes))
    messages = [
        f"{names[index]} is a dielectric, but not closed: lines that enter it never leave; close "
        "it, or make it a thindielectric if it is a single sheet"
        for index in open_shapes
    ]
    touching = _touching(closed)
    messages += [
        f"surfaces of {_pair(names, pair)} touch, or are closer than the offset of Mitsuba's rays: "
        "paths will miss one of them; leave a gap, or thicken the wall"
        for pair in sorted(touching)
    ]
    nested, inside_out = _nesting_faults(closed, touching)
    messages += [
        f"{_pair(names, pair)} overlap or are nested: light in one enters the other as if it came "
        "from air; leave a gap, or give the outer one a cavity (an inner surface whose normals "
        "point into the cavity)"
        for pair in sorted(nested)
    ]
    messages += [
        f"{names[index]} is a dielectric turned inside out: its normals point into the glass; flip "
        "them, or, if it is the surface of a cavity, add the closed outer surface"
        for index in sorted(inside_out)
    ]
    return messages


def _is_dielectric(shape: mi.Shape) -> bool:
    """Whether the surface refracts: Mitsuba sets NonSymmetric where refraction scales radiance."""
    flags = load_mitsuba().BSDFFlags
    kind = shape.bsdf().flags()
    return bool(kind & int(flags.NonSymmetric)) and bool(kind & int(flags.Transmission))


def _pair(names: list[str], pair: tuple[int, int]) -> str:
    first, second = (names[index] for index in pair)
    return f"parts of {first}" if pair[0] == pair[1] else f"{first} and {second}"


def _touching(crossings: Crossings) -> set[tuple[int, int]]:
    """Pairs of shapes whose surfaces are closer than the offset of a ray's origin."""
    near, next_one = slice(None, -1), slice(1, None)
    step, normal = crossings.step, crossings.normal
    gap = np.diff(crossings.distance) * np.abs((normal * crossings.direction).sum(axis=1)[near])
    facing = (normal[near] * normal[next_one]).sum(axis=1) * step[near] * step[next_one]
    same_line = crossings.line[near] == crossings.line[next_one]
    found = same_line & (gap < crossings.offset[near]) & (facing > _PARALLEL)
    pairs = np.sort(np.stack([crossings.shape[near], crossings.shape[next_one]], -1)[found], axis=1)
    totals = np.bincount(crossings.shape) if len(crossings.shape) else np.zeros(0)
    unique, counts = np.unique(pairs, axis=0, return_counts=True)
    return {
        (int(a), int(b))
        for (a, b), count in zip(unique, counts, strict=True)
        if count >= _MIN_SHARE * min(totals[a], totals[b])
    }


def _nesting_faults(
    crossings: Crossings, touching: set[tuple[int, int]]
) -> tuple[set[tuple[int, int]], set[int]]:
    """Pairs of shapes that overlap or are nested, and shapes that are inside out.

    The crossings are with closed shapes, so that the steps of each line sum to 0. Where shapes
    touch, the order of their crossings is not reliable.
    """
    depth = np.cumsum(crossings.step)
    suspicious = np.unique(crossings.line[(depth < 0) | (depth > 1)])
    stride = -(-len(suspicious) // _MAX_EXAMINED) or 1
    chosen = crossings.take(np.isin(crossings.line, suspicious[::stride]))
    nested: set[tuple[int, int]] = set()
    inside_out: set[int] = set()
    line, entered, missing = -1, [], 0
    for at, shape, step in zip(
        chosen.line.tolist(), chosen.shape.tolist(), chosen.step.tolist(), strict=True
    ):
        if at != line:
            line, entered, missing = at, [], 0
        if step < 0 and entered:
            entered.pop()
        elif step < 0:
            missing += 1
            inside_out.add(shape)
        elif missing:
            missing -= 1
        else:
            if entered:
                nested.add((min(entered[-1], shape), max(entered[-1], shape)))
            entered.append(shape)
    return nested - touching, inside_out - {shape for pair in touching for shape in pair}
