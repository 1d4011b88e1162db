"""Triangles of a glTF mesh."""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.lamp.importers.gltf.accessors import Accessors
from lumitree.lamp.importers.gltf.item import Item
from lumitree.lamp.meshes import Floats, Mesh, area_normals

MAX_TRIANGLES = 20_000_000
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


def read_triangles(accessors: Accessors, primitive: Item, uv_set: int) -> Mesh | None:
    """A primitive's triangles, with normals; None where it holds points, lines or nothing.

    Texture coordinates of the number `uv_set` are read; the mesh has none if they are missing.
    """
    attributes = primitive.item("attributes")
    mode = primitive.integer("mode", _TRIANGLES)
    if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in attributes:
        return None
    position = attributes.integer("POSITION")
    count = accessors.count(position)
    indexed = primitive.index("indices")
    corners = count if indexed is None else accessors.count(indexed)
    if corners > 3 * MAX_TRIANGLES:
        raise primitive.error(f"has {corners} corners; at most {3 * MAX_TRIANGLES} are read")
    positions = accessors.floats(position, (3,))
    order = np.arange(count) if indexed is None else accessors.integers(indexed)
    if order.max() >= count:
        raise primitive.error(f"uses vertex {order.max()} of {count}; its indices are damaged")
    faces = _faces(order, mode)
    # Triangles without area join parts of strips.
    faces = faces[(area_normals(positions, faces) != 0).any(axis=1)]
    if not len(faces):
        return None
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)

    def attribute(name: str, lengths: tuple[int, ...]) -> Floats | None:
        index = attributes.index(name)
        if index is None:
            return None
        values = accessors.floats(index, lengths)
        if len(values) != count:
            raise primitive.error(f"has {count} vertices, but {len(values)} of {name}")
        return values[used]

    colours = attribute("COLOR_0", (3, 4))
    mesh = Mesh(
        positions[used],
        np.zeros((len(used), 3)),
        faces,
        attribute(f"TEXCOORD_{uv_set}", (2,)),
        None if colours is None else np.clip(colours[:, :3], 0.0, 1.0),
    )
    normals = attribute("NORMAL", (3,))
    return _faceted(mesh) if normals is None else _with_normals(mesh, normals)


def baked(mesh: Mesh, world: Floats) -> Mesh:
    """The mesh moved by an affine map [4, 4] of any invertible kind; faces keep their front."""
    linear = world[:3, :3]
    normals = mesh.normals @ np.linalg.inv(linear)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = mesh.faces[:, ::-1] if np.linalg.det(linear) < 0 else mesh.faces
    vertices = mesh.vertices @ linear.T + world[:3, 3]
    return dataclasses.replace(mesh, vertices=vertices, normals=normals, faces=faces)


def _faces(order: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    if mode == _TRIANGLES:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    if len(order) < 3:
        return np.zeros((0, 3), np.int64)
    if mode == _FAN:
        first = np.full(len(order) - 2, order[0])
        return np.stack([order[1:-1], order[2:], first], axis=1)
    faces = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
    # Every other triangle of a strip runs the other way round.
    faces[1::2] = faces[1::2][:, [0, 2, 1]]
    return faces


def _faceted(mesh: Mesh) -> Mesh:
    """Every face with vertices and a normal of its own, as glTF asks where normals are missing."""
    normals = area_normals(mesh.vertices, mesh.faces)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    corners = mesh.faces.ravel()
    return Mesh(
        mesh.vertices[corners],
        np.repeat(normals, 3, axis=0),
        np.arange(len(corners)).reshape(-1, 3),
        None if mesh.uv is None else mesh.uv[corners],
        None if mesh.colours is None else mesh.colours[corners],
    )


def _with_normals(mesh: Mesh, normals: Floats) -> Mesh:
    """With unit normals; zero ones become the mean of the faces around the vertex."""
    lengths = np.linalg.norm(normals, axis=1)
    missing = lengths < 1e-6
    if missing.any():
        around = np.zeros_like(normals)
        for corner in range(3):
            np.add.at(around, mesh.faces[:, corner], area_normals(mesh.vertices, mesh.faces))
        around[(around == 0).all(axis=1)] = (0.0, 1.0, 0.0)
        normals = np.where(missing[:, None], around, normals)
        lengths = np.linalg.norm(normals, axis=1)
    return dataclasses.replace(mesh, normals=normals / lengths[:, None])
