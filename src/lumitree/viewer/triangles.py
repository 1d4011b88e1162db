"""The triangles of the page, and the radiance at their vertices without the noise of its paths.

Baked triangles with long sides are divided: radiance is stored at their vertices.

The smooth radiance x is the solution of (M + Λ) x = M values: M is the area of each vertex, and Λ
the Laplacian of the mesh with weights ℓ² cot / 2. Light spreads over the distance ℓ, and its sum
over connected vertices stays. ℓ is as long as noise needs it: in a plane, the paths in an area of
4 π ℓ² are averaged.
"""

import dataclasses
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

from lumitree.asset.geometry import MeshArrays
from lumitree.asset.materials import Texture, places_on_image
from lumitree.viewer.surfaces import Patterns

# Longest sides, local units.
_LONGEST_SIDE, _MOST_DIVISIONS = 1 / 16, 8
# Barycentric coordinates of points of a triangle at which its pattern is taken.
_POINTS = np.array([[i, j, 9 - i - j] for i in range(1, 9) for j in range(1, 9 - i)]) / 9
# Normal of vertices whose normal is not used.
_UPWARDS = np.array([0, 0, 1], np.float32)
# Relative error that is aimed at, and longest ℓ, local units.
_ERROR, _LONGEST = 0.03, 0.05
# Power of the cosine between normals: light does not spread across edges.
_SHARPNESS = 64
# Limits of cotangents: triangles with obtuse or small angles.
_COTANGENTS = 0.02, 4.0
# Iterations for the first estimate of noise, and for the result.
_FIRST, _STEPS = 6, 24


class JoinedArrays(NamedTuple):
    """Arrays of meshes.

    Attributes:
        vertices, normals: [V, 3].
        places: [V, 2] of the vertices on the image of their pattern.
        means: [V, 3] of the pattern over the triangles of a vertex.
        faces: [F, 3] vertices of the triangles.
        surfaces: [F] rows of their surfaces.
    """

    vertices: NDArray[np.float32]
    normals: NDArray[np.floating]
    places: NDArray[np.float64]
    means: NDArray[np.floating]
    faces: NDArray[np.integer]
    surfaces: NDArray[np.integer]


class Triangles:
    """Meshes that are joined to one."""

    def __init__(self, patterns: Patterns) -> None:
        self._patterns = patterns
        self._parts: list[JoinedArrays] = []
        self._count = 0

    def add(
        self,
        mesh: MeshArrays,
        row: int,
        baked: bool,
        pattern: tuple[int, Texture] | None,
    ) -> None:
        """Add a mesh.

        Args:
            row: of its surface.
            baked: whether rays end at it; then it needs no normals.
            pattern: as `Patterns.of` returns it.
        """
        vertices, faces = mesh["vertices"], mesh["faces"]
        faces = faces[_areas(vertices[faces]) > 0]
        places = np.zeros((len(vertices), 2))
        normals = mesh.get("normals", np.tile(_UPWARDS, (len(vertices), 1)))
        if pattern is not None and "texcoords" in mesh:
            places = places_on_image(pattern[1].to_uv, mesh["texcoords"])
        if baked:
            if "normals" not in mesh:
                # Each triangle has a radiance by itself.
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
        part = JoinedArrays(vertices, normals, places, mean, faces + self._count, numbers)
        self._parts.append(part)
        self._count += len(vertices)

    def joined(self) -> JoinedArrays:
        """Arrays of all meshes."""
        return JoinedArrays(*map(np.concatenate, zip(*self._parts, strict=True)))

    def _mean(
        self,
        pattern: tuple[int, Texture],
        places: NDArray[np.float64],
        faces: NDArray[np.integer],
    ) -> NDArray[np.float64]:
        """Mean [V, 3] of a pattern about vertices, weighted as radiance is."""
        sums, weights = np.zeros((len(places), 3)), np.zeros(len(places))
        corners = places[faces]
        for weight in _POINTS:
            at, wrap = np.einsum("k,fkd->fd", weight, corners), pattern[1].wrap_mode
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
    for _ in range(_MOST_DIVISIONS):
        corners = vertices[faces]
        sides = np.linalg.norm(corners - np.roll(corners, 1, axis=1), axis=-1)
        long = sides.max(axis=1) > _LONGEST_SIDE
        if not long.any():
            break
        middles, quarters = quartered(faces[long], len(vertices))
        faces = np.concatenate([faces[~long], quarters])
        vertices, places = (
            np.concatenate([each, each[middles].mean(axis=1)]) for each in (vertices, places)
        )
    return (
        np.asarray(vertices, np.float32),
        np.asarray(places, np.float64),
        np.asarray(faces, np.int64),
    )


def quartered(
    faces: NDArray[np.integer], count: int
) -> tuple[NDArray[np.integer], NDArray[np.integer]]:
    """Triangles that are each divided into four, by the middles of their sides.

    As `trimesh.remesh.subdivide`, whose import takes longer than the page.

    Args:
        faces: [F, 3].
        count: number of vertices before; the middles come after them.

    Returns:
        [M, 2] the two vertices that each middle is between; and [4 F, 3].
    """
    sides = np.sort(np.stack([faces, np.roll(faces, -1, axis=1)], axis=-1).reshape(-1, 2), axis=1)
    codes = sides.astype(np.int64) @ [1, count]
    codes, inverse = np.unique(codes, return_inverse=True)
    (a, b, c), (ab, bc, ca) = faces.T, count + inverse.reshape(-1, 3).T
    quarters = np.stack([a, ab, ca, ab, b, bc, ca, bc, c, ab, bc, ca], axis=1).reshape(-1, 3)
    return np.stack([codes % count, codes // count], axis=1), quarters


def smoothed(
    values: NDArray[np.float32],
    variance: NDArray[np.float32],
    paths: NDArray[np.floating],
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
) -> NDArray[np.float32]:
    """Values [V, N] at the vertices of a mesh without noise.

    Args:
        values: [V, N] means of paths; the first three are radiance.
        variance: [V] of the mean of R, G and B of one path.
        paths: [V] number of paths.
        vertices, faces: [V, 3] and [F, 3], local units.
    """
    mesh = _Mesh.of(vertices.astype(np.float64), faces)
    first = np.stack([values[:, :3].mean(axis=1), variance], axis=1)
    mean, spread = mesh.spread(first, (_LONGEST / 2) ** 2, _FIRST).T
    density = 4 * np.pi * np.maximum(paths, 1e-9) / mesh.area
    square = np.maximum(spread, 0) / np.maximum(_ERROR * mean, 1e-9) ** 2 / density
    limit = np.minimum(square[mesh.first], square[mesh.second])
    return mesh.spread(values, np.minimum(limit, _LONGEST**2), _STEPS)


@dataclasses.dataclass(frozen=True, eq=False)
class _Mesh:
    """Areas [V] of vertices, and sides of triangles [3 F] with their weights."""

    area: NDArray[np.float64]
    first: NDArray[np.integer]
    second: NDArray[np.integer]
    weight: NDArray[np.float64]

    @classmethod
    def of(cls, vertices: NDArray[np.float64], faces: NDArray[np.integer]) -> "_Mesh":
        count, corners = len(vertices), vertices[faces]
        cross = np.cross(corners[:, 1] - corners[:, 0], corners[:, 2] - corners[:, 0])
        twice = np.maximum(np.linalg.norm(cross, axis=1), 1e-12)
        area = np.bincount(faces.ravel(), np.repeat(twice / 6, 3), count)
        of_faces = np.repeat(cross, 3, axis=0).T
        normals = np.stack([np.bincount(faces.ravel(), each, count) for each in of_faces], axis=1)
        normals /= np.maximum(np.linalg.norm(normals, axis=1, keepdims=True), 1e-20)
        first, second = np.roll(faces, -1, axis=1).T.ravel(), np.roll(faces, -2, axis=1).T.ravel()
        opposite = vertices[faces.T.ravel()]
        products = ((vertices[first] - opposite) * (vertices[second] - opposite)).sum(axis=1)
        cotangent = np.clip(products / np.tile(twice, 3), *_COTANGENTS)
        cosine = np.maximum((normals[first] * normals[second]).sum(axis=1), 0)
        return cls(np.maximum(area, 1e-12), first, second, cotangent / 2 * cosine**_SHARPNESS)

    def spread(
        self, values: NDArray[np.floating], square: NDArray[np.float64] | float, steps: int
    ) -> NDArray[np.float32]:
        """Solve for values [V, N] by conjugate gradients; `square` is ℓ² of the sides."""
        weight, count = (self.weight * square).astype(np.float32), len(values)
        links = coo_array((weight, (self.first, self.second)), (count, count)).tocsr()
        links = links + links.T
        area = self.area.astype(np.float32)[:, None]
        diagonal = area + np.asarray(links.sum(axis=1), np.float32)[:, None]
        found = values.astype(np.float32)
        rest = area * found - (diagonal * found - links @ found)
        direction = scaled = rest / diagonal
        product = (rest * scaled).sum(axis=0)
        for _ in range(steps):
            image = diagonal * direction - links @ direction
            length = product / np.maximum((direction * image).sum(axis=0), 1e-30)
            found, rest = found + length * direction, rest - length * image
            scaled, before = rest / diagonal, product
            product = (rest * scaled).sum(axis=0)
            direction = scaled + product / np.maximum(before, 1e-30) * direction
        return np.maximum(found, 0)
