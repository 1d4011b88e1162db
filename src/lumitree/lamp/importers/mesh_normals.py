"""Normals of faces, and shading normals that are smooth except at creases."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.lamp.importers.topology import Indices, Pieces, connected
from lumitree.lamp.meshes import Floats, Mesh, area_normals

# Sharpest angle between the normals of two faces, degrees, across which shading is smooth.
CREASE = 40.0


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
    around = np.zeros_like(mesh.normals)
    for corner in range(3):
        np.add.at(around, faces[:, corner], area_normals(mesh.vertices, faces))
    back = (around * mesh.normals).sum(axis=1) < 0
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
