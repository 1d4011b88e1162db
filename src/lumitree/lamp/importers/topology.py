"""Which parts of a mesh are closed, how they are oriented, and which lie inside others.

The notions, which are the same for all file formats:

* *place*: vertices whose positions are equal, to a tolerance, are in one place (`weld`). The
  faces [F, 3] of this module are triples of places, so that vertices which a file repeats do not
  open a surface.
* *repeated*: a face whose corners are in the same places as the corners of another. Copies may be
  rounded differently, so the tolerance is larger here (`repeats`).
* *piece*: a set of faces that are connected by edges.
* *consistent*: at every edge of the piece, as many faces run along it one way as the other, so
  that neighbouring faces have the same orientation.
* *closed*: every edge of the piece belongs to exactly two faces. Where solids touch along an edge
  it belongs to four faces or more: such a piece is closed if it is consistent.
* *solid*: closed, consistent, and with a volume. A sheet that is covered by a second one of
  opposite orientation is closed, but not solid.
* *oriented outwards*: a closed piece has a positive signed volume, so that the normals of its
  faces point to the outside. One inside another piece is the wall of a cavity: its signed volume
  is negative, and its normals point into the cavity. One inside two others has a positive volume
  again, and so on.

It also has the normals of faces, and shading normals that are smooth except at creases.
"""

import dataclasses
import warnings
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeWarning
from lumitree.lamp.importers.polygons import newell
from lumitree.lamp.meshes import Floats, Mesh, area_normals, summed_at_vertices

Indices = NDArray[np.int64]

# Smallest tolerance of `weld`, as a fraction of the bounding box's diagonal.
_WELD = 5e-7
# Distance of corners that are in one place to `repeats`, as a fraction of the diagonal of a
# material's bounding box.
_REPEATED = 1e-5
# Most half-edges in one place that are taken for neighbours.
_MAX_AT_EDGE = 8
# Closed pieces with a smaller volume, divided by area^1.5, are two sheets in one place; a sphere
# has 0.09.
_MIN_FULLNESS = 1e-6
# Largest number of tests of a triangle against a point with which pieces inside others are sought.
_MAX_NESTING_WORK = 2_000_000_000
# Most pieces that `has_body` looks at.
_MAX_BODIES = 32
# Vertices of a piece that must all lie inside another piece.
_NESTING_PROBES = 8
# Sharpest angle between the normals of two faces, degrees, across which shading is smooth.
CREASE = 40.0


def weld(positions: Floats, reach: float = 0.0) -> Indices:
    """Index [V] of each vertex's place, from 0; equal for vertices [V, 3] in one place.

    Vertices no farther apart than `reach`, and at least 5e-7 of the bounding box's diagonal, along
    each axis are in one place; so are those connected by others.
    """
    if not len(positions):
        return np.zeros(0, np.int64)
    reach = max(float(np.linalg.norm(np.ptp(positions, axis=0))) * _WELD, reach, 1e-300)
    scaled = (positions - positions.min(axis=0)) / reach
    links = []
    # Two values no more than 1 apart share a cell of width 2 in one of two grids shifted by 1.
    for shift in np.ndindex(2, 2, 2):
        cell = np.floor((scaled + shift) / 2).astype(np.int64)
        key = (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2]
        order = np.argsort(key, kind="stable")
        same = np.diff(key[order]) == 0
        links.append(np.stack([order[:-1][same], order[1:][same]], axis=1))
    return connected(np.concatenate(links), len(positions))


def connected(links: Indices, count: int) -> Indices:
    """Index [count] of the connected component of each node; `links` [L, 2] join nodes."""
    # Imported where it is used: it takes half a second.
    import trimesh

    labels = trimesh.graph.connected_component_labels(links, node_count=count)
    return np.asarray(labels).astype(np.int64)


def reach(points: Floats) -> float:
    """Largest distance of corners that are in one place; `points` [..., 3] are a material's."""
    return _REPEATED * float(np.linalg.norm(np.ptp(points.reshape(-1, 3), axis=0)))


def repeats(corners: Floats, within: float) -> tuple[Indices, NDArray[np.bool_]]:
    """The first face [F] in the place of each, and whether [F] the face is wound the other way.

    Two faces of opposite winding where solids touch, or a solid is folded, do not repeat each
    other: without one the solid would be open. The neighbours of a repeated face are repeated, too.
    `corners` [F, N, 3] are of faces of one material, `within` is its `reach`.
    """
    first, turned = _in_one_place(corners, within)
    if turned.any():
        single = np.bincount(first, minlength=len(first))[first] == 1
        sheet = _sheets(corners, within, first)
        kept = turned & (np.bincount(sheet, single) > 0)[sheet]
        first[kept], turned[kept] = np.flatnonzero(kept), False
    return first, turned


def _sheets(corners: Floats, within: float, first: Indices) -> Indices:
    """Index [F] of the sheet of each face: neighbours of one orientation, and none in one place."""
    count, size = corners.shape[:2]
    start = weld(corners.reshape(-1, 3), within)
    stop = np.roll(start.reshape(count, size), -1, axis=1).ravel()
    edge = np.minimum(start, stop) * (int(start.max()) + 1) + np.maximum(start, stop)
    order = np.argsort(edge, kind="stable")
    edge, forward, place = edge[order], (start < stop)[order], np.repeat(first, size)[order]
    links = []
    for step in range(1, _MAX_AT_EDGE):
        near, far = slice(0, -step), slice(step, None)
        joined = (edge[near] == edge[far]) & (forward[near] != forward[far])
        joined &= place[near] != place[far]
        links.append(np.stack([order[near][joined], order[far][joined]], axis=1) // size)
    return connected(np.concatenate(links), count)


def _in_one_place(corners: Floats, within: float) -> tuple[Indices, NDArray[np.bool_]]:
    """As `repeats`, without regard to neighbours."""
    first, turned = np.arange(len(corners)), np.zeros(len(corners), np.bool_)
    near = weld(corners.mean(axis=1), within)
    chosen = np.flatnonzero(np.bincount(near)[near] > 1)
    if not len(chosen):
        return first, turned
    near_ones = corners[chosen]
    places = weld(near_ones.reshape(-1, 3), within).reshape(near_ones.shape[:2])
    sets = np.sort(places, axis=1)
    # Faces too small for this comparison would all look alike.
    small = (np.diff(sets, axis=1) == 0).any(axis=1)
    order = np.lexsort(sets.T)
    new = np.ones(len(sets), bool)
    new[1:] = (np.diff(sets[order], axis=0) != 0).any(axis=1)
    same = np.empty(len(sets), np.int64)
    same[order] = order[new][np.cumsum(new) - 1]
    same[small] = np.flatnonzero(small)
    first[chosen], turned[chosen] = chosen[same], _turned(near_ones, places, same)
    if small.any() and within > 0:
        finer, turned[chosen[small]] = _in_one_place(near_ones[small], 0.0)
        first[chosen[small]] = chosen[small][finer]
    return first, turned


def _turned(corners: Floats, places: Indices, same: Indices) -> NDArray[np.bool_]:
    """Whether faces [F, N, 3] are wound the other way than the faces `same` of their corners."""
    if places.shape[1] > 3:
        normals = newell(corners)
        return (normals * normals[same]).sum(axis=1) < 0
    # By the order of the corners: triangles without any area have no normals.
    turn = (places.argmin(axis=1)[:, None] + np.arange(3)) % 3
    cycles = np.take_along_axis(places, turn, axis=1)
    return (cycles != cycles[same]).any(axis=1)


class Pieces:
    """The pieces of a surface of at least one face.

    Args:
        faces: [F, 3] places.

    Attributes:
        label: [F] index of every face's piece.
        closed: [P] whether the piece is closed.
        consistent: [P] whether the piece is consistent.
        pairs: [E, 2] half-edges of neighbouring faces; a half-edge is 3 x face + corner.
    """

    def __init__(self, faces: Indices) -> None:
        edges = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        low, high = edges.min(axis=1), edges.max(axis=1)
        key = low * (int(high.max()) + 1) + high
        order = np.argsort(key, kind="stable")
        same = np.diff(key[order]) == 0
        self.pairs = np.stack([order[:-1][same], order[1:][same]], axis=1)
        self.label = connected(self.pairs // 3, len(faces))
        edge = np.empty(len(edges), np.int64)
        edge[order] = np.cumsum(np.concatenate([[0], ~same]))
        forward = np.where(edges[:, 0] < edges[:, 1], 1, -1)
        faces_at = np.bincount(edge)[edge]
        balanced = np.bincount(edge, forward)[edge] == 0
        owner, count = np.repeat(self.label, 3), int(self.label.max()) + 1

        def everywhere(condition: NDArray[np.bool_]) -> NDArray[np.bool_]:
            return np.bincount(owner[~condition], minlength=count) == 0

        self.consistent = everywhere(balanced)
        self.closed = everywhere(faces_at == 2) | (everywhere(faces_at % 2 == 0) & self.consistent)


def count_solids(mesh: Mesh) -> tuple[int, int]:
    """Number of solid pieces of a mesh whose repeated faces count once, and of all its pieces."""
    first, _ = repeats(mesh.vertices[mesh.faces], reach(mesh.vertices))
    faces = mesh.faces[first == np.arange(len(first))]
    pieces = Pieces(weld(mesh.vertices)[faces])
    area = np.linalg.norm(area_normals(mesh.vertices, faces), axis=1) / 2
    area = np.bincount(pieces.label, area)
    full = np.abs(_volumes(mesh.vertices, faces, pieces)) > _MIN_FULLNESS * area**1.5
    return int((pieces.closed & pieces.consistent & full).sum()), len(pieces.closed)


def is_solid(mesh: Mesh) -> bool:
    """Whether all pieces of a mesh are solid."""
    solids, pieces = count_solids(mesh)
    return solids == pieces


def probes(vertices: Floats) -> Floats:
    """Some of the vertices [P, 3] of a piece or a part, by which it is found inside others."""
    return vertices[np.linspace(0, len(vertices) - 1, _NESTING_PROBES).astype(np.int64)]


def has_body(mesh: Mesh, alike: Sequence[Floats], others: Sequence[Floats]) -> bool:
    """Whether a solid mesh has a piece that is no sheet around something else, as a bulb is.

    There is nothing in such a piece, or the inner side of its wall. Some of many pieces are tested
    against `probes` of other parts of the mesh's material (`alike`) and of other materials.
    """
    if not is_solid(mesh):
        return False
    label = Pieces(weld(mesh.vertices)[mesh.faces]).label
    order = np.argsort(label, kind="stable")
    corners = mesh.vertices[mesh.faces[order]]
    pieces = np.split(corners, np.cumsum(np.bincount(label))[:-1])
    points = [probes(piece.reshape(-1, 3)) for piece in pieces]
    for at in range(0, len(pieces), -(-len(pieces) // _MAX_BODIES)):
        piece = pieces[at]
        if any(_encloses(piece, each) for each in (*points[:at], *points[at + 1 :], *alike)):
            return True
        if not any(_encloses(piece, each) for each in others):
            return True
    return False


def faces_to_turn(
    positions: Floats, faces: Indices, pieces: Pieces, where: str
) -> NDArray[np.bool_]:
    """Faces [F] to be turned round so that all closed pieces are oriented outwards.

    Closed pieces are made consistent first. Faces of open pieces are not turned. Faces [F, 3] index
    the positions [N, 3]; `where` names the surface in a warning.
    """
    import trimesh

    wound = faces.copy()
    for piece in np.flatnonzero(pieces.closed & ~pieces.consistent):
        chosen = pieces.label == piece
        mesh = trimesh.Trimesh(positions, faces[chosen], process=False)
        trimesh.repair.fix_winding(mesh)
        wound[chosen] = mesh.faces
    volume = _volumes(positions, wound, pieces)
    cavity = _nesting(positions, wound, pieces, where) % 2 == 1
    wrong = pieces.closed & ((volume < 0) != cavity) & (volume != 0)
    return (wound != faces).any(axis=1) ^ wrong[pieces.label]


def _volumes(positions: Floats, faces: Indices, pieces: Pieces) -> Floats:
    """Signed volume [P] of each piece; without meaning for open pieces."""
    count = len(pieces.closed)
    first = np.full(count, len(faces))
    np.minimum.at(first, pieces.label, np.arange(len(faces)))
    # Relative to a vertex of each piece: far from the origin the sum would lose precision.
    corners = positions[faces] - positions[faces[first, 0]][pieces.label][:, None]
    six = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum(axis=1)
    return np.bincount(pieces.label, six, minlength=count) / 6


def _nesting(positions: Floats, faces: Indices, pieces: Pieces, where: str) -> Indices:
    """Number [P] of closed pieces around each closed piece; 0, after a warning, if too many."""
    depth = np.zeros(len(pieces.closed), np.int64)
    closed = np.flatnonzero(pieces.closed)
    if len(closed) < 2:
        return depth
    order = np.argsort(pieces.label, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(pieces.label))[:-1])
    boxes = [positions[faces[groups[piece]].ravel()] for piece in closed]
    low = np.stack([box.min(axis=0) for box in boxes])
    high = np.stack([box.max(axis=0) for box in boxes])
    points = [probes(box) for box in boxes]
    work = len(closed) ** 2
    for outer, piece in enumerate(closed):
        within = ((low > low[outer]) & (high < high[outer])).all(axis=1)
        work += int(within.sum()) * len(groups[piece]) * _NESTING_PROBES
        if work > _MAX_NESTING_WORK:
            warnings.warn(
                f"{where}: too many closed pieces to find those inside others; none is taken to be "
                "the wall of a cavity",
                LumitreeWarning,
                stacklevel=2,
            )
            return np.zeros_like(depth)
        triangles = positions[faces[groups[piece]]]
        for inner in np.flatnonzero(within):
            depth[closed[inner]] += _encloses(triangles, points[inner])
    return depth


def _encloses(triangles: Floats, points: Floats) -> bool:
    """Whether all points [P, 3] are inside a closed surface [F, 3, 3], by its solid angle.

    Van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", IEEE Trans. Biomed. Eng.
    30(2), 1983.
    """
    low, high = triangles.min(axis=(0, 1)), triangles.max(axis=(0, 1))
    if not ((points > low) & (points < high)).all():
        return False
    for point in points:
        a, b, c = np.moveaxis(triangles - point, 1, 0)
        la, lb, lc = (np.linalg.norm(corner, axis=1) for corner in (a, b, c))
        above = (a * np.cross(b, c)).sum(axis=1)
        below = la * lb * lc + (a * b).sum(1) * lc + (b * c).sum(1) * la + (c * a).sum(1) * lb
        turns = np.arctan2(above, below).sum() / (2 * np.pi)
        if abs(turns) < 0.5:
            return False
    return True


def face_normals(positions: Floats, faces: Indices) -> Floats:
    """Unit normals [F, 3]; zero for a face without area."""
    normals = area_normals(positions, faces)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


def crease_normals(
    positions: Floats, faces: Indices, pieces: Pieces, groups: Indices, crease: float = CREASE
) -> tuple[Indices, Floats]:
    """Index [F, 3] of every corner's shading normal, and the unit normals [M, 3].

    Normals are smooth across edges, except across creases: edges sharper than `crease` degrees,
    between two smoothing groups [F], or of group 0. Faces [F, 3] index the positions [N, 3].
    """
    flat = face_normals(positions, faces)
    pairs = pieces.pairs
    first, second = pairs[:, 0] // 3, pairs[:, 1] // 3
    smooth = (flat[first] * flat[second]).sum(axis=1) > np.cos(np.radians(crease))
    smooth &= (groups[first] == groups[second]) & (groups[first] != 0)
    pairs = pairs[smooth]
    # A half-edge runs from corner k to corner k + 1 of its face. Corners in one place are joined.
    starts, stops = pairs, pairs - pairs % 3 + (pairs + 1) % 3
    corner = faces.ravel()
    parallel = corner[starts[:, 0]] == corner[starts[:, 1]]
    crossed = np.where(parallel[:, None], starts, np.stack([starts[:, 0], stops[:, 1]], 1))
    others = np.where(parallel[:, None], stops, np.stack([stops[:, 0], starts[:, 1]], 1))
    labels = connected(np.concatenate([crossed, others]), len(corner))
    weighted = (flat[:, None] * _angles(positions, faces)[..., None]).reshape(-1, 3)
    sums = np.zeros((int(labels.max()) + 1, 3))
    np.add.at(sums, labels, weighted)
    return labels.reshape(-1, 3), unit(sums)


def turned_with_normals(mesh: Mesh, turn: NDArray[np.bool_]) -> Mesh:
    """The mesh with the faces that `turn` [F] marks turned round, and normals on their front.

    A vertex normal is reversed where it points to the back of the faces around the vertex. Faces
    that are turned should share no vertex with faces that are not.
    """
    faces = np.where(turn[:, None], mesh.faces[:, ::-1], mesh.faces)
    back = (summed_at_vertices(mesh.vertices, faces) * mesh.normals).sum(axis=1) < 0
    normals = np.where(back[:, None], -mesh.normals, mesh.normals)
    return dataclasses.replace(mesh, faces=faces, normals=normals)


def unit(vectors: Floats) -> Floats:
    """Unit vectors along vectors [N, 3]; +y in place of zero."""
    length = np.linalg.norm(vectors, axis=1, keepdims=True)
    up = np.broadcast_to([0.0, 1.0, 0.0], vectors.shape).copy()
    return np.divide(vectors, length, out=up, where=length > 0)


def _angles(positions: Floats, faces: Indices) -> Floats:
    """Interior angles [F, 3], radians."""
    points = positions[faces]
    ahead = np.roll(points, -1, axis=1) - points
    back = np.roll(points, 1, axis=1) - points
    cross = np.linalg.norm(np.cross(ahead, back), axis=-1)
    return np.arctan2(cross, (ahead * back).sum(axis=-1))
