"""Whether a mesh bounds a solid, and which side of it is outside."""

import dataclasses

import numpy as np
import trimesh
from numpy.typing import NDArray

from lumitree.importers.gltf.primitives import face_normals
from lumitree.model.geometry import Floats, Mesh

# Of the bounding box's largest side: vertices nearer than this are one.
_WELD = 1e-6
# Beyond this many bodies it is not asked which of them lie inside which; nor is a body tried
# against more than so many others. Both bound the time that a file can take.
_MAX_BODIES, _MAX_TRIES = 4000, 8


def is_closed(mesh: Mesh) -> bool:
    """Whether the mesh, welded by position, has no boundary and one winding throughout."""
    welded = _welded(mesh)
    return bool(welded.is_watertight and welded.is_winding_consistent)


def outward(mesh: Mesh) -> Mesh:
    """A closed mesh with its front, and its normals, on the outside of every body.

    A body that lies inside another keeps its orientation relative to it: the inner wall of a
    hollow bulb faces the cavity.
    """
    welded = _welded(mesh)
    body = trimesh.graph.connected_component_labels(
        welded.face_adjacency, node_count=len(mesh.faces)
    )
    a, b, c = (welded.vertices[welded.faces[:, i]] for i in range(3))
    volume = np.zeros(body.max() + 1)
    np.add.at(volume, body, (np.cross(a, b) * c).sum(axis=1))
    host = _hosts(np.asarray(welded.vertices), np.asarray(welded.faces), body, volume)
    flip = (volume[host] < 0)[body]
    faces = np.where(flip[:, None], mesh.faces[:, ::-1], mesh.faces)
    # A face's vertices belong to one body, unless two bodies share a vertex of the file.
    mesh = dataclasses.replace(mesh, faces=faces)
    towards = np.zeros_like(mesh.normals)
    for corner in range(3):
        np.add.at(towards, faces[:, corner], face_normals(mesh))
    wrong = (towards * mesh.normals).sum(axis=1) < 0
    return dataclasses.replace(mesh, normals=np.where(wrong[:, None], -mesh.normals, mesh.normals))


def _welded(mesh: Mesh) -> trimesh.Trimesh:
    low = mesh.vertices.min(axis=0)
    step = float(np.ptp(mesh.vertices, axis=0).max()) * _WELD
    cell = np.round((mesh.vertices - low) / step).astype(np.int64)
    key = (cell[:, 0] << 42) | (cell[:, 1] << 21) | cell[:, 2]
    _, first, same = np.unique(key, return_index=True, return_inverse=True)
    return trimesh.Trimesh(mesh.vertices[first] - low, same[mesh.faces], process=False)


def _hosts(
    vertices: Floats, faces: NDArray[np.int64], body: NDArray[np.int64], volume: Floats
) -> NDArray[np.int64]:
    """For each body, the largest body that contains it; itself where none does."""
    host = np.arange(len(volume))
    if not 1 < len(volume) <= _MAX_BODIES:
        return host
    corners = vertices[faces]
    low = np.full((len(volume), 3), np.inf)
    high = np.full((len(volume), 3), -np.inf)
    np.minimum.at(low, body, corners.min(axis=1))
    np.maximum.at(high, body, corners.max(axis=1))
    point = np.zeros((len(volume), 3))
    point[body] = corners[:, 0]
    order = np.argsort(body, kind="stable")
    pieces = np.split(corners[order], np.flatnonzero(np.diff(body[order])) + 1)
    for inner in range(len(volume)):
        around = (low < low[inner]).all(axis=1) & (high > high[inner]).all(axis=1)
        candidates = np.flatnonzero(around)
        largest = candidates[np.argsort(-np.abs(volume[candidates]))][:_MAX_TRIES]
        for outer in largest:
            if abs(_winding(pieces[outer], point[inner])) > 0.5:
                host[inner] = outer
                break
    return host


def _winding(corners: Floats, point: Floats) -> float:
    """Winding number of triangles [F, 3, 3] around a point, from their solid angles.

    Van Oosterom and Strackee, "The Solid Angle of a Plane Triangle", 1983.
    """
    a, b, c = ((corners - point)[:, i] for i in range(3))
    x, y, z = (np.linalg.norm(side, axis=1) for side in (a, b, c))
    above = (a * np.cross(b, c)).sum(axis=1)
    below = x * y * z + (a * b).sum(axis=1) * z + (b * c).sum(axis=1) * x + (c * a).sum(axis=1) * y
    return float(2 * np.arctan2(above, below).sum() / (4 * np.pi))
