"""Mean radiance that the surfaces of an asset's geometry send out, as images show it."""

from collections.abc import Mapping
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.device import on_device, transforms_as_parameters
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.rendering.asset_images import asset_scene
from lumitree.trace.cameras import PATH_DEPTH
from lumitree.trace.light_paths import seeded_sampler

# Equal assets give equal radiance: there is no option for the seed.
_ROOT_SEED = 0
_SAMPLES_AT_ONCE = 1 << 19
# Distance from a surface at which rays towards it begin, local units.
_ABOVE = 1e-5


def vertex_radiance(
    asset: Asset,
    vertices: NDArray[np.float32],
    faces: NDArray[np.uint32],
    samples_per_face: int,
    name: str = "surfaces",
    lights: Mapping[str, Any] | None = None,
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Mean radiance at the vertices of surfaces, over all directions of the front's hemisphere.

    The mean is weighted by the cosine, so that a surface that sent out the same radiance to all
    sides would have the same radiosity. Places on a face count for its vertices by their
    barycentric coordinates.

    Args:
        asset: has geometry.
        vertices: [V, 3] of surfaces of the geometry, local frame.
        faces: [F, 3] triangles, with the same fronts as the geometry.
        samples_per_face: paths for each face.
        name: for the display of progress.
        lights: other members of the scene, for `mi.load_dict`, local frame. Default: none.

    Returns:
        [V, 3], W/(m² sr), and [V], the variance of a path's mean of R, G and B; 0 for a vertex of
        no face.
    """
    scene = mi.load_dict({**asset_scene(asset), **(lights or {})})
    transforms_as_parameters(scene.shapes())
    integrator: Any = mi.load_dict({"type": "lumitree_path", "max_depth": PATH_DEPTH})
    points = on_device(mi.Float, vertices)
    corners = on_device(mi.UInt32, faces)
    sums = np.zeros((len(vertices), 5))
    at_once = max(1, _SAMPLES_AT_ONCE // samples_per_face)
    with progress(name, len(faces)) as advance:
        for step, first in enumerate(range(0, len(faces), at_once)):
            count = min(at_once, len(faces) - first)
            samples = count * samples_per_face
            sampler = seeded_sampler(SeedStream(Purpose.SURFACES, step).seed(_ROOT_SEED), samples)
            start = dr.opaque(mi.UInt32, first)
            face = start + dr.arange(mi.UInt32, samples) // samples_per_face
            index = dr.gather(mi.Vector3u, corners, face)
            a, b, c = (dr.gather(mi.Point3f, points, each) for each in index)
            u, v = mi.warp.square_to_uniform_triangle(sampler.next_2d())
            weights = (1 - u - v, u, v)
            normal = dr.normalize(dr.cross(b - a, c - a))
            away = mi.Frame3f(normal).to_world(
                mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
            )
            # A face without area has no normal.
            seen = dr.all(dr.isfinite(away))
            point = weights[0] * a + weights[1] * b + weights[2] * c
            ray = mi.RayDifferential3f(mi.Ray3f(point + _ABOVE * away, -away))
            radiance, _, _ = integrator.sample(scene, sampler, ray, None, seen)
            colour = mi.Color3f(radiance)
            known = (*colour, dr.square(dr.mean(colour)), mi.Float(1))
            values = [dr.select(seen, each, 0) for each in known]
            # Else each sum would trace the paths again.
            dr.eval(weights, values)
            # In a stated order: sums by several threads would differ in their last bits.
            parts = [[dr.block_sum(w * each, samples_per_face) for w in weights] for each in values]
            dr.eval(parts)
            at = faces[first : first + count].T.ravel()
            for column, part in enumerate(parts):
                of_corners = np.concatenate([np.array(each, np.float64) for each in part])
                sums[:, column] += np.bincount(at, of_corners, len(sums))
            advance(count)
    means = (sums / np.maximum(sums[:, 4:], 1e-20)).astype(np.float32)
    return means[:, :3], np.maximum(means[:, 3] - means[:, :3].mean(axis=1) ** 2, 0)
