"""The triangles of the page. Those with long sides are divided where rays end, at whose vertices
radiance is stored.
"""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.textures import Json, texture_map
from lumitree.output.viewer.patterns import Patterns

# Longest sides, local units.
_LONGEST_SIDE, _MOST_DIVISIONS = 1 / 16, 8
# Barycentric coordinates of points of a triangle at which its pattern is taken.
_POINTS = np.array([[i, j, 9 - i - j] for i in range(1, 9) for j in range(1, 9 - i)]) / 9
# Normal of vertices whose normal is not used.
_UPWARDS = np.array([0, 0, 1], np.float32)


class Triangles:
    """Meshes that are joined to one."""

    def __init__(self, patterns: Patterns) -> None:
        self._patterns = patterns
        self._parts: list[tuple[NDArray[Any], ...]] = []
        self._count = 0

    def add(
        self,
        mesh: dict[str, NDArray[Any]],
        row: int,
        ends: bool,
        pattern: tuple[int, Json] | None,
    ) -> None:
        """Add a mesh.

        Args:
            row: of its surface.
            ends: whether rays end at it; normals are then left out.
            pattern: as `Patterns.of` returns it.
        """
        vertices, faces = mesh["vertices"], mesh["faces"]
        faces = faces[_areas(vertices[faces]) > 0]
        places = np.zeros((len(vertices), 2))
        normals = mesh.get("normals", np.tile(_UPWARDS, (len(vertices), 1)))
        if pattern is not None and "texcoords" in mesh:
            places = texture_map(pattern[1]["to_uv"], mesh["texcoords"])
        if ends:
            if "normals" not in mesh:
                # Each triangle by itself, as it has a radiance of its own.
                vertices, places = (
                    each[faces].reshape(-1, each.shape[1]) for each in (vertices, places)
                )
                faces = np.arange(len(vertices)).reshape(-1, 3)
            vertices, places, faces = _divided(vertices, places, faces)
            normals = np.tile(_UPWARDS, (len(vertices), 1))
        mean = np.ones((len(vertices), 3))
        if pattern is not None:
            mean = self._mean(pattern, places, faces)
        numbers = np.full(len(faces), row)
        self._parts.append((vertices, normals, places, mean, faces + self._count, numbers))
        self._count += len(vertices)

    def joined(self) -> tuple[NDArray[Any], ...]:
        """Arrays of all meshes.

        Returns:
            Of vertices: positions and normals [V, 3], places on the image of their pattern [V, 2],
            and means of the pattern over their triangles [V, 3]. Of triangles: vertices [F, 3] and
            rows of surfaces [F].
        """
        return tuple(map(np.concatenate, zip(*self._parts, strict=True)))

    def _mean(
        self,
        pattern: tuple[int, Json],
        places: NDArray[np.float64],
        faces: NDArray[np.integer],
    ) -> NDArray[np.float64]:
        """Mean [V, 3] of a pattern about vertices, weighted as radiance is."""
        sums, weights = np.zeros((len(places), 3)), np.zeros(len(places))
        corners = places[faces]
        for weight in _POINTS:
            at, wrap = np.einsum("k,fkd->fd", weight, corners), pattern[1]["wrap_mode"]
            values = self._patterns.values(pattern[0], at, wrap)
            for corner, share in enumerate(weight):
                np.add.at(sums, faces[:, corner], share * values)
                np.add.at(weights, faces[:, corner], share)
        return sums / np.maximum(weights, 1e-9)[:, None]


def _areas(corners: NDArray[np.floating]) -> NDArray[np.floating]:
    """Twice the areas of triangles [F, 3, 3]."""
    first, second, third = np.moveaxis(corners, 1, 0)
    return np.linalg.norm(np.cross(second - first, third - first), axis=-1)


def _divided(
    vertices: NDArray[np.floating],
    places: NDArray[np.floating],
    faces: NDArray[np.integer],
) -> tuple[NDArray[np.float32], NDArray[np.float64], NDArray[np.int64]]:
    """Vertices, their places and triangles, of which those with long sides are divided."""
    from trimesh.remesh import subdivide

    for _ in range(_MOST_DIVISIONS):
        corners = vertices[faces]
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
        long = np.flatnonzero(sides.max(axis=1) > _LONGEST_SIDE)
        if not len(long):
            break
        divided: Any = subdivide(vertices, faces, long, {"places": places})
        vertices, faces, places = *divided[:2], divided[2]["places"]
    return (
        np.asarray(vertices, np.float32),
        np.asarray(places, np.float64),
        np.asarray(faces, np.int64),
    )
