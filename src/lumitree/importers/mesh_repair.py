"""What files made by modellers need before light can be traced through them.

Faces here are triples of *welded* vertices: vertices in one place have one number, however often
the file repeats them. A *piece* is a set of faces connected by edges. It is closed where each of
its edges belongs to two faces, or to as many wound one way as the other.
"""

import warnings

import numpy as np
import trimesh
from numpy.typing import NDArray

from lumitree.errors import LumitreeWarning
from lumitree.model.geometry import Floats, Mesh

Indices = NDArray[np.int64]

# Of the bounding box's diagonal: vertices nearer than this are in one place.
_WELD = 5e-7
# Closed pieces with less volume, over area^1.5, are a sheet laid double; a sphere has 0.09.
_MIN_FULLNESS = 1e-6
CREASE = 40.0
# Pairs of pieces and triangles looked at to find hollow glass, before that is given up.
_MAX_NESTING_WORK = 2_000_000_000
_NESTING_PROBES = 8


def weld(positions: Floats, tolerance: float = _WELD) -> Indices:
    """Number [V] of each vertex's place, the same for vertices [V, 3] in one place.

    Args:
        tolerance: of the bounding box's diagonal, at least 5e-7.
    """
    if not len(positions):
        return np.zeros(0, np.int64)
    reach = max(float(np.linalg.norm(np.ptp(positions, axis=0))) * tolerance, 1e-300)
    scaled = (positions - positions.min(axis=0)) / reach
    links = []
    # Two values no more than 1 apart share a cell of width 2 in one of two grids shifted by 1.
    for shift in np.ndindex(2, 2, 2):
        cell = np.floor((scaled + shift) / 2).astype(np.int64)
        key = (cell[:, 0] << 42) + (cell[:, 1] << 21) + cell[:, 2]
        order = np.argsort(key, kind="stable")
        same = np.diff(key[order]) == 0
        links.append(np.stack([order[:-1][same], order[1:][same]], axis=1))
    return _connected(np.concatenate(links), len(positions))


def _connected(links: Indices, count: int) -> Indices:
    """Number [count] of the connected set that each node belongs to."""
    labels = trimesh.graph.connected_component_labels(links, node_count=count)
    return np.asarray(labels).astype(np.int64)


class Pieces:
    """The pieces of a surface of at least one face.

    Attributes:
        label: [F] piece of every face.
        closed: [P] whether the piece encloses a volume.
        consistent: [P] whether every edge has as many faces wound one way as the other.
        pairs: [E, 2] neighbouring faces' half-edges, 3 x face + corner.
    """

    def __init__(self, faces: Indices) -> None:
        ends = faces[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)
        low, high = ends.min(axis=1), ends.max(axis=1)
        key = low * (int(high.max()) + 1) + high
        order = np.argsort(key, kind="stable")
        same = np.diff(key[order]) == 0
        self.pairs = np.stack([order[:-1][same], order[1:][same]], axis=1)
        self.label = _connected(self.pairs // 3, len(faces))
        edge = np.empty(len(ends), np.int64)
        edge[order] = np.cumsum(np.concatenate([[0], ~same]))
        forward = np.where(ends[:, 0] < ends[:, 1], 1, -1)
        faces_at = np.bincount(edge)[edge]
        balanced = np.bincount(edge, forward)[edge] == 0
        owner, count = np.repeat(self.label, 3), int(self.label.max()) + 1

        def everywhere(condition: NDArray[np.bool_]) -> NDArray[np.bool_]:
            return np.bincount(owner[~condition], minlength=count) == 0

        self.consistent = everywhere(balanced)
        self.closed = everywhere(faces_at == 2) | (everywhere(faces_at % 2 == 0) & self.consistent)


def closed_share(mesh: Mesh) -> tuple[int, int]:
    """Number of closed pieces of a mesh, and of all; a sheet laid double is not closed."""
    faces, places = mesh.faces, weld(mesh.vertices)
    pieces = Pieces(places[faces])
    a, b, c = np.moveaxis(mesh.vertices[faces], 1, 0)
    area = np.bincount(pieces.label, np.linalg.norm(np.cross(b - a, c - a), axis=1) / 2)
    full = np.abs(_volumes(mesh.vertices, faces, pieces)) > _MIN_FULLNESS * area**1.5
    return int((pieces.closed & full).sum()), len(pieces.closed)


def outward(positions: Floats, faces: Indices, pieces: Pieces, name: str) -> Indices:
    """The faces, those of closed pieces wound so that they enclose positive volume.

    Where a closed piece lies inside another one it is the inner side of a wall, and encloses
    negative volume; inside a second one it is outside again, and so on.

    Args:
        positions: [V, 3].
        faces: [F, 3] welded vertices.
        pieces: of the faces.
        name: of the material, for a warning.
    """
    faces = faces.copy()
    for piece in np.flatnonzero(pieces.closed & ~pieces.consistent):
        chosen = pieces.label == piece
        mesh = trimesh.Trimesh(positions, faces[chosen], process=False)
        trimesh.repair.fix_winding(mesh)
        faces[chosen] = mesh.faces
    volume = _volumes(positions, faces, pieces)
    hollow = _nesting(positions, faces, pieces, name) % 2 == 1
    wrong = pieces.closed & ((volume < 0) != hollow) & (volume != 0)
    turned = wrong[pieces.label]
    faces[turned] = faces[turned][:, ::-1]
    return faces


def _volumes(positions: Floats, faces: Indices, pieces: Pieces) -> Floats:
    """Signed volume [P]; of no meaning for open pieces."""
    count = len(pieces.closed)
    first = np.full(count, len(faces))
    np.minimum.at(first, pieces.label, np.arange(len(faces)))
    # About a point of each piece: far from the origin the sum would lose its digits.
    corners = positions[faces] - positions[faces[first, 0]][pieces.label][:, None]
    six = (corners[:, 0] * np.cross(corners[:, 1], corners[:, 2])).sum(axis=1)
    return np.bincount(pieces.label, six, minlength=count) / 6


def _nesting(positions: Floats, faces: Indices, pieces: Pieces, name: str) -> Indices:
    """Number [P] of closed pieces that each closed piece lies inside of."""
    depth = np.zeros(len(pieces.closed), np.int64)
    closed = np.flatnonzero(pieces.closed)
    if len(closed) < 2:
        return depth
    order = np.argsort(pieces.label, kind="stable")
    groups = np.split(order, np.cumsum(np.bincount(pieces.label))[:-1])
    boxes = [positions[faces[groups[piece]].ravel()] for piece in closed]
    low = np.stack([box.min(axis=0) for box in boxes])
    high = np.stack([box.max(axis=0) for box in boxes])
    probes = np.stack(
        [box[np.linspace(0, len(box) - 1, _NESTING_PROBES).astype(np.int64)] for box in boxes]
    )
    work = len(closed) ** 2
    for outer, piece in enumerate(closed):
        within = ((low > low[outer]) & (high < high[outer])).all(axis=1)
        work += int(within.sum()) * len(groups[piece]) * _NESTING_PROBES
        if work > _MAX_NESTING_WORK:
            warnings.warn(
                f"material {name!r}: too many closed pieces to find those inside one another; "
                "all are taken to be solid",
                LumitreeWarning,
                stacklevel=2,
            )
            return np.zeros_like(depth)
        triangles = positions[faces[groups[piece]]]
        for inner in np.flatnonzero(within):
            depth[closed[inner]] += _encloses(triangles, probes[inner])
    return depth


def _encloses(triangles: Floats, points: Floats) -> bool:
    """Whether a closed surface [F, 3, 3] has all the points [P, 3] inside, by its solid angle.

    Van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", IEEE Trans. Biomed. Eng.
    30(2), 1983.
    """
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
    a, b, c = np.moveaxis(positions[faces], 1, 0)
    normals = np.cross(b - a, c - a)
    length = np.linalg.norm(normals, axis=1, keepdims=True)
    return np.divide(normals, length, out=np.zeros_like(normals), where=length > 0)


def crease_normals(
    positions: Floats, faces: Indices, pieces: Pieces, groups: Indices, crease: float = CREASE
) -> tuple[Indices, Floats]:
    """Shading normals that are smooth across gentle edges.

    Args:
        positions: [V, 3].
        faces: [F, 3] welded vertices.
        pieces: of the faces.
        groups: [F] smoothing group; an edge between two groups is hard, and so is every edge of
            group 0.
        crease: edges sharper than this angle, degrees, are hard.

    Returns:
        Number [F, 3] of every corner's normal, and the unit normals [N, 3].
    """
    flat = face_normals(positions, faces)
    pairs = pieces.pairs
    first, second = pairs[:, 0] // 3, pairs[:, 1] // 3
    smooth = (flat[first] * flat[second]).sum(axis=1) > np.cos(np.radians(crease))
    smooth &= (groups[first] == groups[second]) & (groups[first] != 0)
    pairs = pairs[smooth]
    # A half-edge runs from corner k to corner k + 1 of its face; ends in one place are joined.
    starts, stops = pairs, pairs - pairs % 3 + (pairs + 1) % 3
    corner = faces.ravel()
    parallel = corner[starts[:, 0]] == corner[starts[:, 1]]
    crossed = np.where(parallel[:, None], starts, np.stack([starts[:, 0], stops[:, 1]], 1))
    others = np.where(parallel[:, None], stops, np.stack([stops[:, 0], starts[:, 1]], 1))
    labels = _connected(np.concatenate([crossed, others]), len(corner))
    weighted = (flat[:, None] * _angles(positions, faces)[..., None]).reshape(-1, 3)
    sums = np.zeros((int(labels.max()) + 1, 3))
    np.add.at(sums, labels, weighted)
    return labels.reshape(-1, 3), unit(sums)


def unit(vectors: Floats) -> Floats:
    """Vectors [N, 3] made unit length; +y where one has none."""
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
