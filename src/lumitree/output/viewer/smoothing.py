"""Radiance at vertices without the noise of the paths that found it.

The solution x of (M + Λ) x = M values: M is the area of each vertex, and Λ the Laplacian of the
mesh with weights ℓ² cot / 2. Light spreads over the distance ℓ, and its sum over connected vertices
stays. ℓ is as long as noise needs it: in a plane, the paths in an area of 4 π ℓ² are averaged.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray
from scipy.sparse import coo_array

# Relative error that is aimed at, and longest ℓ, local units.
_ERROR, _LONGEST = 0.03, 0.05
# Power of the cosine between normals: light does not spread across edges.
_SHARPNESS = 64
# Limits of cotangents: triangles with obtuse or small angles.
_COTANGENTS = 0.02, 4.0
# Iterations for the first estimate of noise, and for the result.
_FIRST, _STEPS = 6, 24


def smoothed(
    values: NDArray[np.float32],
    variance: NDArray[np.float32],
    paths: NDArray[np.floating],
    vertices: NDArray[np.floating],
    faces: NDArray[np.integer],
) -> NDArray[np.float32]:
    """Values [V, N] without noise.

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
    limit = np.minimum(square[mesh.starts], square[mesh.ends])
    return mesh.spread(values, np.minimum(limit, _LONGEST**2), _STEPS)


@dataclasses.dataclass(frozen=True, eq=False)
class _Mesh:
    """Areas [V] of vertices, and sides of triangles [3 F] with their weights."""

    area: NDArray[np.float64]
    starts: NDArray[np.integer]
    ends: NDArray[np.integer]
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
        starts, ends = np.roll(faces, -1, axis=1).T.ravel(), np.roll(faces, -2, axis=1).T.ravel()
        opposite = vertices[faces.T.ravel()]
        products = ((vertices[starts] - opposite) * (vertices[ends] - opposite)).sum(axis=1)
        cotangent = np.clip(products / np.tile(twice, 3), *_COTANGENTS)
        cosine = np.maximum((normals[starts] * normals[ends]).sum(axis=1), 0)
        return cls(np.maximum(area, 1e-12), starts, ends, cotangent / 2 * cosine**_SHARPNESS)

    def spread(
        self, values: NDArray[np.floating], square: NDArray[np.float64] | float, steps: int
    ) -> NDArray[np.float32]:
        """Solve for values [V, N] by conjugate gradients; `square` is ℓ² of the sides."""
        weight, count = (self.weight * square).astype(np.float32), len(values)
        links = coo_array((weight, (self.starts, self.ends)), (count, count)).tocsr()
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
