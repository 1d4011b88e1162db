"""The shapes of an asset's geometry as triangle meshes, for programs without other shapes."""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.geometry import ARRAYS, AssetGeometry
from lumitree.asset.textures import Json
from lumitree.core.frames import similarity_scale
from lumitree.lamp.meshes import areas_on_image

# Segments of a circle in place of an analytic shape.
_SEGMENTS = 96

# Part of a mesh from which on it is both mirrored and not, and what is lost then.
MIXED = 0.01
MIRRORED_PARTLY = "normal maps are wrong where texture coordinates are mirrored beside others"

Arrays = dict[str, NDArray[Any]]


def geometry_meshes(geometry: AssetGeometry, to_frame: NDArray[np.float64]) -> list[Arrays]:
    """Arrays of each shape: `vertices`, `faces`, and `normals`, `texcoords` and `colours` if any.

    `to_frame` [4, 4] is a similarity from the frame of the luminaire's file to another one.
    """
    # From the geometry's coordinates, in double precision: they may be far from the file's.
    matrix = to_frame @ geometry.file_from_geometry
    rotation = matrix[:3, :3] / similarity_scale(to_frame, "to_frame")
    found = []
    for shape, stored in zip(geometry.shapes, geometry.meshes(), strict=True):
        mesh = _analytic(shape) if stored is None else {k: v for k, v in stored.items() if len(v)}
        faces = mesh["faces"]
        placed: Arrays = {"vertices": mesh["vertices"] @ matrix[:3, :3].T + matrix[:3, 3]}
        sign = -1 if shape["flipped"] else 1
        placed["faces"] = faces[:, ::-1] if shape["flipped"] else faces
        if "normals" in mesh:
            placed["normals"] = sign * mesh["normals"] @ rotation.T
        placed |= {name: mesh[name] for name in ("texcoords", "colours") if name in mesh}
        found.append(
            {
                name: np.ascontiguousarray(values, np.uint32 if name == "faces" else np.float32)
                for name, values in placed.items()
            }
        )
    return found


def mirrored_share(mesh: Arrays) -> float:
    """Part of a mesh whose texture coordinates are mirrored, by their area; 0 without any.

    There the second axis of normal maps is turned round in other programs, but not in Mitsuba,
    which has the product of the normal and the first axis.
    """
    if "texcoords" not in mesh:
        return 0.0
    area = areas_on_image(mesh["texcoords"].astype(np.float64), mesh["faces"])
    return float(area[area > 0].sum() / max(np.abs(area).sum(), 1e-300))


def meshed(geometry: AssetGeometry) -> AssetGeometry:
    """The geometry with meshes in place of its analytic shapes."""
    stored = geometry.meshes()
    shapes: list[Json] = []
    arrays: dict[str, list[NDArray[Any]]] = {name: [] for name in ARRAYS}
    for shape, known in zip(geometry.shapes, stored, strict=True):
        mesh = _analytic(shape) if known is None else known
        if known is None:
            counts = {"vertices": len(mesh["vertices"]), "faces": len(mesh["faces"])}
            has = {"normals": True, "texcoords": True, "colours": False}
            shape = {**shape, "type": "mesh", **counts, **has}
            del shape["to_world"]
        shapes.append(shape)
        for name in mesh:
            arrays[name].append(mesh[name])
    joined: dict[str, NDArray[Any]] = {
        name: np.concatenate([np.zeros((0, width)), *arrays[name]]).astype(kind)
        for name, (kind, width) in ARRAYS.items()
    }
    return dataclasses.replace(geometry, shapes=tuple(shapes), **joined)


def _analytic(shape: Json) -> Arrays:
    """Mesh of a sphere, disk, cylinder or rectangle, in the geometry's coordinates."""
    mesh = _UNIT[shape["type"]]()
    matrix = np.array(shape["to_world"], np.float64)
    linear = matrix[:3, :3]
    mesh["vertices"] = mesh["vertices"] @ linear.T + matrix[:3, 3]
    if np.linalg.det(linear) < 0:
        mesh["faces"] = mesh["faces"][:, ::-1]
    normals = mesh["normals"] @ np.linalg.inv(linear)
    mesh["normals"] = normals / np.linalg.norm(normals, axis=1, keepdims=True)
    return mesh


def _rectangle() -> Arrays:
    corners = np.array([[-1.0, -1, 0], [1, -1, 0], [1, 1, 0], [-1, 1, 0]])
    return {
        "vertices": corners,
        "normals": np.tile([0.0, 0, 1], (4, 1)),
        "texcoords": (corners[:, :2] + 1) / 2,
        "faces": np.array([[0, 1, 2], [0, 2, 3]]),
    }


def _sphere() -> Arrays:
    azimuth, polar = _grid(_SEGMENTS // 2, np.pi)
    flat = np.sin(polar)
    points = np.stack([flat * np.cos(azimuth), flat * np.sin(azimuth), np.cos(polar)], axis=-1)
    return _surface(points, points, np.stack([azimuth / (2 * np.pi), polar / np.pi], axis=-1))


def _cylinder() -> Arrays:
    azimuth, height = _grid(1, 1.0)
    ring = np.cos(azimuth), np.sin(azimuth)
    points, normals = np.stack([*ring, height], axis=-1), np.stack([*ring, 0 * height], axis=-1)
    return _surface(points, normals, np.stack([azimuth / (2 * np.pi), height], axis=-1))


def _disk() -> Arrays:
    azimuth, radius = _grid(1, 1.0)
    points = np.stack([radius * np.cos(azimuth), radius * np.sin(azimuth), 0 * radius], axis=-1)
    normals = np.broadcast_to([0.0, 0, 1], points.shape)
    return _surface(points, normals, np.stack([radius, azimuth / (2 * np.pi)], axis=-1))


def _grid(steps: int, end: float) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Azimuth and a parameter from 0 to `end` [_SEGMENTS + 1, steps + 1]; the seam is double."""
    azimuth = np.linspace(0, 2 * np.pi, _SEGMENTS + 1)
    return tuple(np.meshgrid(azimuth, np.linspace(0, end, steps + 1), indexing="ij"))  # type: ignore[return-value]


def _surface(points: Any, normals: Any, texcoords: Any) -> Arrays:
    """Mesh of a grid of points [N, M, 3]; faces turn as the normals point."""
    index = np.arange(points[..., 0].size).reshape(points.shape[:2])
    first, second, third, fourth = index[:-1, :-1], index[1:, :-1], index[1:, 1:], index[:-1, 1:]
    faces = np.stack([[first, second, third], [first, third, fourth]]).transpose(0, 2, 3, 1)
    mesh = {"vertices": points, "normals": normals, "texcoords": texcoords}
    arrays = {name: values.reshape(-1, values.shape[-1]) for name, values in mesh.items()}
    faces = faces.reshape(-1, 3)
    corners = arrays["vertices"][faces]
    geometric = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
    # At a pole and at a disk's centre one of the two triangles of a cell is flat.
    area = np.linalg.norm(geometric, axis=1)
    faces, geometric = faces[area > 1e-9], geometric[area > 1e-9]
    outwards = (geometric * arrays["normals"][faces].sum(axis=1)).sum(axis=1) > 0
    faces = np.where(outwards[:, None], faces, faces[:, ::-1])
    return {**arrays, "faces": faces}


_UNIT = {"sphere": _sphere, "cylinder": _cylinder, "disk": _disk, "rectangle": _rectangle}
