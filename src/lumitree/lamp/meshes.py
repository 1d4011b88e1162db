"""Triangle meshes: parts of them, surfaces of revolution and swept tubes with smooth normals.

Lengths are in the caller's unit; y is up. Faces are counter-clockwise seen from where the normals
point. A pole, where a ring of vertices would have no radius, is one vertex, so that closed
profiles and tubes give closed meshes.
"""

import dataclasses
from collections.abc import Iterable, Iterator

import numpy as np
from numpy.typing import ArrayLike, NDArray

Floats = NDArray[np.float64]


@dataclasses.dataclass(frozen=True)
class Mesh:
    """A triangle mesh.

    Attributes:
        vertices: [V, 3] positions.
        normals: [V, 3] unit shading normals.
        faces: [F, 3] indices of vertices.
        uv: [V, 2] texture coordinates, v = 0 at the image's first row; None for none.
        colours: [V, 3] linear RGB in [0, 1]; None for none.
    """

    vertices: Floats
    normals: Floats
    faces: NDArray[np.int64]
    uv: Floats | None = None
    colours: Floats | None = None

    def taken(self, vertices: NDArray[np.int64], faces: NDArray[np.int64]) -> "Mesh":
        """The vertices with these indices, and faces [F, 3] of them."""
        uv, colours = (None if v is None else v[vertices] for v in (self.uv, self.colours))
        return Mesh(self.vertices[vertices], self.normals[vertices], faces, uv, colours)


def join(meshes: Iterable[Mesh]) -> Mesh:
    """All the meshes as one, without texture coordinates; vertices are not merged."""
    meshes = list(meshes)
    offsets = np.cumsum([0, *(len(mesh.vertices) for mesh in meshes[:-1])])
    return Mesh(
        np.concatenate([mesh.vertices for mesh in meshes]),
        np.concatenate([mesh.normals for mesh in meshes]),
        np.concatenate([mesh.faces + at for mesh, at in zip(meshes, offsets, strict=True)]),
    )


def lathe(profile: ArrayLike, segments: int, crease: float = 35.0) -> Mesh:
    """Surface of revolution of a profile [N, 2], radius and y, about the y axis.

    Followed upwards, the normals point away from the axis, so a solid's profile runs
    counter-clockwise from axis to axis. Only its two ends may lie on the axis. Corners sharper than
    `crease` degrees get a hard edge (two rings of vertices in one place); others are smooth.
    """
    profile = np.asarray(profile, np.float64)
    steps = np.diff(profile, axis=0)
    flat = np.stack([steps[:, 1], -steps[:, 0]], axis=1) / np.linalg.norm(
        steps, axis=1, keepdims=True
    )
    hard = np.zeros(len(profile), bool)
    hard[1:-1] = (flat[:-1] * flat[1:]).sum(axis=1) < np.cos(np.radians(crease))
    # A hard corner appears twice: it ends one smooth run of the profile and begins the next.
    order = np.repeat(np.arange(len(profile)), 1 + hard)
    joined = order[1:] != order[:-1]
    before, after = flat[np.maximum(order - 1, 0)], flat[np.minimum(order, len(flat) - 1)]
    before[1:][~joined] = after[1:][~joined]
    after[:-1][~joined] = before[:-1][~joined]
    normal = before + after
    normal[profile[order, 0] == 0, 0] = 0.0
    normal /= np.linalg.norm(normal, axis=1, keepdims=True)

    angle = 2 * np.pi * np.arange(segments) / segments

    def revolve(pair: Floats) -> Floats:
        radius, y = pair[:, :1], pair[:, 1:]
        return np.stack(np.broadcast_arrays(radius * np.cos(angle), y, -radius * np.sin(angle)), -1)

    return skin(revolve(profile[order]), revolve(normal), joined)


def sphere(radius: float, segments: int) -> Mesh:
    """Sphere about the origin."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, segments // 2 + 1)
    profile = radius * np.column_stack([np.cos(angle), np.sin(angle)])
    profile[[0, -1], 0] = 0.0
    return lathe(profile, segments)


def area_normals(positions: Floats, faces: NDArray[np.int64]) -> Floats:
    """Normals [F, 3] of faces [F, 3] of positions [V, 3]; their length is twice the area."""
    a, b, c = np.moveaxis(positions[faces], 1, 0)
    return np.cross(b - a, c - a)


def summed_at_vertices(positions: Floats, faces: NDArray[np.int64]) -> Floats:
    """Sum [V, 3] of the area normals of the faces around each vertex."""
    around, normals = np.zeros_like(positions), area_normals(positions, faces)
    for corner in range(3):
        np.add.at(around, faces[:, corner], normals)
    return around


def areas_on_image(uv: NDArray[np.floating], faces: NDArray[np.integer]) -> Floats:
    """Twice the areas [F] of faces [F, 3] on an image, by uv [V, 2]; positive where mirrored."""
    (x, y), (z, w) = (uv[faces[:, i]].T - uv[faces[:, 0]].T for i in (1, 2))
    # v points down, so counter-clockwise faces run clockwise in (u, v).
    return x * w - y * z


def facets(triangles: Floats) -> Mesh:
    """Flat-shaded triangles [N, 3, 3], each with three vertices of its own."""
    positions, faces = triangles.reshape(-1, 3), np.arange(3 * len(triangles)).reshape(-1, 3)
    normals = area_normals(positions, faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    return Mesh(positions, np.repeat(normals, 3, axis=0), faces)


def moved(mesh: Mesh, place: Floats) -> Mesh:
    """The mesh's positions and normals moved by a similarity [4, 4]."""
    turn = place[:3, :3] / np.cbrt(np.linalg.det(place[:3, :3]))
    vertices = mesh.vertices @ place[:3, :3].T + place[:3, 3]
    return dataclasses.replace(mesh, vertices=vertices, normals=mesh.normals @ turn.T)


def sweep(path: ArrayLike, radius: ArrayLike, segments: int) -> Mesh:
    """Closed tube along a path [N, 3], with slightly domed ends; [N] radii may change slowly.

    The path's radius of curvature must exceed the tube's radius.
    """
    path = np.asarray(path, np.float64)
    tangent, side, up = frames(path)
    angle = 2 * np.pi * np.arange(segments) / segments
    around = side[:, None] * np.cos(angle)[:, None] + up[:, None] * np.sin(angle)[:, None]
    radii = np.broadcast_to(np.asarray(radius, np.float64), len(path))
    rings = path[:, None] + radii[:, None, None] * around
    first, last = path[0] - radii[0] / 2 * tangent[0], path[-1] + radii[-1] / 2 * tangent[-1]
    rings = np.concatenate([_ring(first, segments), rings, _ring(last, segments)])
    normals = np.concatenate([_ring(-tangent[0], segments), around, _ring(tangent[-1], segments)])
    return skin(rings, normals, np.ones(len(rings) - 1, bool))


def frames(path: Floats) -> tuple[Floats, Floats, Floats]:
    """Unit tangents and two unit normals [N, 3] each, carried along the path without twist.

    Parallel transport by double reflection: Wang et al., "Computation of Rotation Minimizing
    Frames", ACM TOG 27(1), 2008. Tangent, first and second normal form a right-handed frame.
    """
    tangent = np.gradient(path, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    side = np.empty_like(path)
    side[0] = np.cross(tangent[0], np.eye(3)[np.abs(tangent[0]).argmin()])
    side[0] /= np.linalg.norm(side[0])
    for i, step in enumerate(np.diff(path, axis=0)):
        mirror = 2 / (step @ step) * step
        moved_side = side[i] - (mirror @ side[i]) * step
        moved_tangent = tangent[i] - (mirror @ tangent[i]) * step
        turn = tangent[i + 1] - moved_tangent
        length = turn @ turn
        side[i + 1] = moved_side - (2 * (turn @ moved_side) / length * turn if length else 0)
    return tangent, side, np.asarray(np.cross(tangent, side), np.float64)


def coil(path: ArrayLike, radius: float, pitch: float, samples: int) -> Floats:
    """Helix [M, 3] around a path [N, 3]; first and last turn wind out of and into its ends.

    It advances along the path by `pitch`, in `samples` points, for one turn.
    """
    path = np.asarray(path, np.float64)
    length = float(np.linalg.norm(np.diff(path, axis=0), axis=1).sum())
    axis = resample(path, round(length / pitch * samples) + 1)
    _, side, up = frames(axis)
    along = np.linspace(0, length, len(axis))[:, None]
    ramp = np.clip(np.minimum(along, length - along) / pitch, 0, 1)
    wound = radius * ramp**2 * (3 - 2 * ramp)
    angle = 2 * np.pi * along / pitch
    return axis + wound * (np.cos(angle) * side + np.sin(angle) * up)


def smooth(points: ArrayLike, rounds: int = 4) -> Floats:
    """Quadratic B-spline of a control polygon [N, D] by Chaikin's corner cutting; ends stay."""
    points = np.asarray(points, np.float64)
    for _ in range(rounds):
        start, end = points[:-1], points[1:]
        cut = np.stack([0.75 * start + 0.25 * end, 0.25 * start + 0.75 * end], axis=1)
        points = np.concatenate([points[:1], cut.reshape(-1, points.shape[1]), points[-1:]])
    return points


def resample(points: Floats, count: int) -> Floats:
    """`count` points [count, D] at equal distances along a polyline [N, D]."""
    lengths = np.linalg.norm(np.diff(points, axis=0), axis=1)
    along = np.concatenate([[0.0], np.cumsum(lengths)])
    wanted = np.linspace(0, along[-1], count)
    return np.stack([np.interp(wanted, along, column) for column in points.T], axis=1)


def offset(profile: Floats, distance: float) -> Floats:
    """Lathe profile [N, 2] from axis to axis, moved inwards (against its normals)."""
    tangent = np.gradient(profile, axis=0)
    tangent /= np.linalg.norm(tangent, axis=1, keepdims=True)
    moved = profile - distance * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    moved[[0, -1], 0] = 0.0
    return moved


def _ring(point: Floats, segments: int) -> Floats:
    return np.broadcast_to(point, (1, segments, 3))


def skin(rings: Floats, normals: Floats, joined: NDArray[np.bool_]) -> Mesh:
    """Join closed rings of vertices by triangles; a ring in a single point becomes one vertex.

    Rings [R, S, 3] are counter-clockwise seen from ahead of the last ring; normals are unit
    vectors. `joined` [R - 1] says whether there are triangles between a ring and the next.
    """
    count, segments, _ = rings.shape
    pole = np.ptp(rings, axis=1).max(axis=1) == 0
    kept = np.ones((count, segments), bool)
    kept[pole, 1:] = False
    index = (np.cumsum(kept) - 1).reshape(count, segments)
    a, b = index[:-1][joined], index[1:][joined]
    corners = (a, np.roll(a, -1, axis=1), np.roll(b, -1, axis=1), b)
    faces = np.concatenate(
        [np.stack([corners[i] for i in pick], -1).reshape(-1, 3) for pick in ((0, 1, 2), (0, 2, 3))]
    )
    proper = (faces != np.roll(faces, 1, axis=1)).all(axis=1)
    return Mesh(rings[kept], normals[kept], faces[proper])


def selected(mesh: Mesh, keep: NDArray[np.bool_]) -> Mesh:
    """The faces that `keep` [F] marks, with the vertices they use."""
    used, faces = np.unique(mesh.faces[keep], return_inverse=True)
    return mesh.taken(used, faces.reshape(-1, 3))


def with_backs(mesh: Mesh, doubled: NDArray[np.bool_], distance: float) -> Mesh:
    """The mesh and a second, reversed copy of the faces that `doubled` [F] marks.

    A surface emits from its front alone; with its copy it emits from both sides. With two faces in
    one place a ray would hit either, so the copy lies behind by a distance in the mesh's unit.
    """
    used, faces = np.unique(mesh.faces[doubled], return_inverse=True)
    count = len(mesh.vertices)
    faces = np.concatenate([mesh.faces, faces.reshape(-1, 3)[:, ::-1] + count])
    both = mesh.taken(np.concatenate([np.arange(count), used]), faces)
    both.vertices[count:] -= distance * both.normals[count:]
    both.normals[count:] *= -1
    return both


def by_handedness(mesh: Mesh, bumpy: bool) -> Iterator[tuple[Mesh, bool]]:
    """The faces whose texture coordinates are mirrored apart from the others, if a mesh is bumpy.

    The second axis of normal maps is turned round there. Mitsuba's is the product of the normal and
    the first axis.
    """
    if not bumpy or mesh.uv is None:
        yield mesh, False
        return
    mirrored = areas_on_image(mesh.uv, mesh.faces) > 0
    for side in (False, True):
        if (mirrored == side).any():
            yield selected(mesh, mirrored == side), side
