"""The geometry of an asset for the page: triangles, and what their surfaces send out.

Symbols
    V, F    vertices and triangles
"""

import dataclasses
import math
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.device import on_device
from lumitree.core.octahedral import octahedral
from lumitree.output.geometry_meshes import geometry_meshes, meshed
from lumitree.output.viewer.surfaces import Kind, Surface, page_surface
from lumitree.rendering.surface_radiance import vertex_radiance

# Codes of coordinates from -1 to 1, local units, and of octahedral coordinates of normals.
_POSITION_CODES, _NORMAL_CODES = 1 << 18, 1 << 11
# Codes of radiance for a factor of 2, and factors of 2 from the least radiance to the largest.
_CODES_A_STOP, _STOPS = 32, 30
# Rays end at triangles whose sides are at most this, local units: their radiance is linear.
_LONGEST_SIDE, _MOST_DIVISIONS = 1 / 16, 8
# Paths that end at all triangles together; and at one, at least and at most.
_PATHS, _LEAST_PATHS, _MOST_PATHS = 1 << 20, 4, 128
# Paths that a vertex has, or shares by smoothing with its neighbours; a step joins about as many.
_PATHS_A_VERTEX, _JOINED = 512, 7
# Normal of vertices whose normal is not used.
_UPWARDS = np.array([0, 0, 1], np.float32)


@dataclasses.dataclass(frozen=True)
class PageModel:
    """The geometry for the page.

    Attributes:
        description: numbers, for JSON.
        arrays: codes by name: "positions" [V, 3], "normals" [V, 2], "light" [V, 6] of the front's
            and the back's R, G and B; "triangles" [F, 3], vertices; and "surfaces" [F], rows of
            the description's "surfaces".
    """

    description: dict[str, Any]
    arrays: dict[str, NDArray[Any]]


def page_model(asset: Asset) -> PageModel:
    """The geometry of an asset, which it has. Its surfaces' radiance is traced here."""
    assert asset.geometry is not None
    # Places on a chord of a curved surface are below it: what is traced has the page's triangles.
    geometry = meshed(asset.geometry)
    asset = dataclasses.replace(asset, geometry=geometry)
    meshes = geometry_meshes(geometry, asset.frame.local_from_world)
    rows: list[Surface] = []
    parts = _Parts()
    for shape, mesh in zip(geometry.shapes, meshes, strict=True):
        surface = page_surface(geometry, shape, asset.frame.scale)
        if surface not in rows:
            rows.append(surface)
        parts.add(mesh, rows.index(surface), ends=surface.kind == Kind.ENDS)
    vertices, normals, faces, surfaces = parts.joined()
    ends = np.array([row.kind == Kind.ENDS for row in rows])[surfaces]
    backs = ends & np.array([row.has_back for row in rows])[surfaces]
    light = _sent_out(asset, vertices, faces[ends], faces[backs])
    largest = float(light.max()) or 1.0

    description = {
        "triangles": len(faces),
        "surfaces": [number for row in rows for number in row.numbers()],
        "max_radiance": largest,
        "codes": [_POSITION_CODES, _NORMAL_CODES, _CODES_A_STOP, _STOPS * _CODES_A_STOP],
    }
    arrays = {
        "positions": _codes(vertices, _POSITION_CODES).astype(np.int32),
        "normals": _codes(_on_octahedron(normals), _NORMAL_CODES).astype(np.int16),
        "light": _radiance_codes(light / largest),
        "triangles": faces.astype(np.int32),
        "surfaces": surfaces.astype(np.uint8 if len(rows) <= 256 else np.uint16),
    }
    return PageModel(description, arrays)


class _Parts:
    """Meshes that are joined to one."""

    def __init__(self) -> None:
        self._parts: list[tuple[NDArray[Any], ...]] = []
        self._count = 0

    def add(self, mesh: dict[str, NDArray[Any]], row: int, ends: bool) -> None:
        """Add a mesh of one surface.

        Args:
            ends: whether rays end at it; normals are then left out.
        """
        vertices, faces = mesh["vertices"], mesh["faces"]
        faces = faces[_areas(vertices[faces]) > 0]
        if ends:
            if "normals" not in mesh:
                # Each triangle by itself, as it has a radiance of its own.
                vertices, faces = vertices[faces].reshape(-1, 3), np.arange(3 * len(faces))
            vertices, faces = _divided(vertices, faces.reshape(-1, 3))
            normals = np.tile(_UPWARDS, (len(vertices), 1))
        else:
            normals = mesh.get("normals", np.tile(_UPWARDS, (len(vertices), 1)))
        numbers = np.full(len(faces), row)
        self._parts.append((vertices, normals, faces + self._count, numbers))
        self._count += len(vertices)

    def joined(self) -> tuple[NDArray[Any], ...]:
        """Vertices [V, 3], normals [V, 3], faces [F, 3] and rows of surfaces [F]."""
        return tuple(map(np.concatenate, zip(*self._parts, strict=True)))


def _areas(corners: NDArray[np.floating]) -> NDArray[np.floating]:
    """Twice the areas of triangles [F, 3, 3]."""
    first, second, third = np.moveaxis(corners, 1, 0)
    return np.linalg.norm(np.cross(second - first, third - first), axis=-1)


def _divided(
    vertices: NDArray[np.floating], faces: NDArray[np.integer]
) -> tuple[NDArray[np.float32], NDArray[np.int64]]:
    """Triangles of which those with long sides are divided."""
    from trimesh.remesh import subdivide

    for _ in range(_MOST_DIVISIONS):
        corners = vertices[faces]
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
        long = np.flatnonzero(sides.max(axis=1) > _LONGEST_SIDE)
        if not len(long):
            break
        vertices, faces = subdivide(vertices, faces, face_index=long)[:2]
    return np.asarray(vertices, np.float32), np.asarray(faces, np.int64)


def _sent_out(
    asset: Asset, vertices: NDArray[np.float32], fronts: NDArray[Any], backs: NDArray[Any]
) -> NDArray[np.float32]:
    """Mean radiance [V, 6] that the front and the back of vertices send out, R, G and B each."""
    count = len(vertices)
    if not len(fronts):
        return np.zeros((count, 6), np.float32)
    # The back is a surface of its own, whose triangles turn the other way.
    faces = np.concatenate([fronts, backs[:, ::-1] + count])
    paths = int(np.clip(_PATHS // len(faces), _LEAST_PATHS, _MOST_PATHS))
    both = np.concatenate([vertices, vertices])
    radiance = vertex_radiance(
        asset, both, faces.astype(np.uint32), paths, f"surfaces of {asset.luminaire}"
    )
    # A vertex has a third of the paths of six triangles.
    steps = math.ceil(max(0.0, _PATHS_A_VERTEX / (2 * paths) - 1) / _JOINED)
    front, back = np.split(_smoothed(radiance, faces, steps), 2)
    return np.concatenate([front, back], axis=1)


def _smoothed(
    values: NDArray[np.float32], faces: NDArray[np.integer], steps: int
) -> NDArray[np.float32]:
    """Means of vertices and their neighbours, `steps` times.

    Args:
        values: [V, 3], each with as many paths as the vertex has triangles.
    """
    from scipy.sparse import coo_array

    count = len(values)
    weight = np.bincount(faces.ravel(), minlength=count).astype(np.float64)
    starts, ends = faces.ravel(), np.roll(faces, 1, axis=1).ravel()
    rows, columns = np.concatenate([starts, ends]), np.concatenate([ends, starts])
    # Both directions of a side that two triangles share are there twice.
    links = coo_array((np.full(len(rows), 0.5), (rows, columns)), (count, count)).tocsr()
    links.setdiag(1.0)
    total = np.concatenate([values * weight[:, None], weight[:, None]], axis=1)
    share = 1 / np.maximum(links.sum(axis=0), 1)
    for _ in range(steps):
        total = links @ (total * share[:, None])
    return (total[:, :3] / np.maximum(total[:, 3:], 1e-9)).astype(np.float32)


def _codes(values: NDArray[np.floating], count: int) -> NDArray[np.floating]:
    """Integers from 0 to `count` - 1 of values from -1 to 1."""
    return np.rint((np.clip(values, -1, 1) + 1) / 2 * (count - 1))


def _on_octahedron(normals: NDArray[np.floating]) -> NDArray[np.float32]:
    """Octahedral coordinates [V, 2]."""
    return np.array(octahedral(on_device(mi.Vector3f, normals)), np.float32).reshape(2, -1).T


def _radiance_codes(relative: NDArray[np.floating]) -> NDArray[np.int16]:
    """Codes of radiance [V, 6] from 0 to 1: R and B of each side as the difference to G.

    A code c > 0 is 2^(c / `_CODES_A_STOP` - `_STOPS`), and 0 is 0.
    """
    stops = np.log2(np.maximum(relative, 2.0 ** -(_STOPS + 1))) + _STOPS
    codes = np.rint(np.maximum(stops, 0) * _CODES_A_STOP).astype(np.int16).reshape(-1, 2, 3)
    codes[..., ::2] -= codes[..., 1:2]
    return codes.reshape(-1, 6)
