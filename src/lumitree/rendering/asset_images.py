"""Images of an asset with nothing around it: its geometry, its field, or else its light field.

Also the mean radiance that the surfaces of its geometry send out, as images show it.
"""

from __future__ import annotations

import dataclasses
from collections.abc import Callable, Mapping, Sequence
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset, light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.core.device import channel_mean, on_device, parameter, transforms_as_parameters
from lumitree.core.frames import similarity_scale
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.lamp.dataset import Frame, Manifest
from lumitree.rendering.device import DeviceAsset
from lumitree.rendering.passes import Budget, Rendering, render_passes
from lumitree.rendering.register import shape
from lumitree.trace.cameras import PATH_DEPTH
from lumitree.trace.light_paths import seeded_sampler

# Equal settings give equal images: there is no option for the seed.
_ROOT_SEED = 0
# Distance from a camera to the nearest surface that it sees, local units.
_NEAR = 1e-3
_SAME = np.eye(4)

# Rays per pixel and side of a field: 4 x 4 rays, stratified, with the box filter of captured views.
RAYS_A_SIDE = 4
_SAMPLES_AT_ONCE = 1 << 19
# Distance from a surface at which rays towards it begin, local units.
_ABOVE = 1e-5

Images = tuple[NDArray[np.float32], NDArray[np.float32]]


def shown_images(
    asset: Asset,
    poses: Sequence[NDArray[np.float64]],
    half_width: float,
    resolution: int,
    spp: int,
) -> list[Images]:
    """Orthographic images of an asset.

    Args:
        poses: [4, 4] `local_from_camera` of cameras, which look along their -z.
        half_width: half the side of the images, local units.
        resolution: pixels per side.
        spp: paths per pixel, where the geometry is shown. The others have 16 rays.

    Returns:
        For each pose radiance [H, W, 3], W/(m² sr), and opacity [H, W]: where the geometry is
        shown, the share of the camera rays that hit a surface, else the straight-through opacity.
    """
    name = f"preview {asset.luminaire}"
    if asset.geometry is not None:
        camera = geometry_camera(asset, half_width, resolution)
        return [camera.take(pose, spp, index, name) for index, pose in enumerate(poses)]
    images = []
    with progress(name, len(poses)) as advance:
        for pose in poses:
            images.append(baked_image(asset, pose, half_width, resolution))
            advance(1)
    return images


def asset_scene(asset: Asset) -> dict[str, object]:
    """Members of a scene, for `mi.load_dict`: the geometry of an asset, with nothing around it.

    No receiver gets the asset's light field there: one cell stands for it, whose tables take no
    time. The frame of the scene is the local one.
    """
    one_cell = make_light_field(np.zeros((1, 3), np.int64), np.ones((1, 16, 3)), depth=1)
    lit = light_field_asset(one_cell, asset.frame, asset.luminaire, asset.spectrum)
    shown = dataclasses.replace(lit, geometry=asset.geometry, light_factors=asset.light_factors)
    lamp = shape(shown, asset.frame.local_from_world, appearance="geometry")
    return {"type": "scene", "lamp": lamp}


def geometry_camera(asset: Asset, half_width: float, resolution: int) -> LampCamera:
    """A camera before the geometry of an asset."""
    return LampCamera(asset_scene(asset), geometry_integrator(), half_width, resolution)


def geometry_integrator() -> mi.Integrator:
    """The integrator that shows the geometry of assets."""
    return mi.load_dict({"type": "lumitree_path", "max_depth": PATH_DEPTH})


class LampCamera:
    """A square orthographic camera before a lamp; the scene is loaded once.

    Arguments and units as for `shown_images`. The frame of the scene is the local one by default.
    """

    def __init__(
        self,
        scene: Mapping[str, object],
        integrator: mi.Integrator,
        half_width: float,
        resolution: int,
        scene_from_local: NDArray[np.float64] = _SAME,
    ) -> None:
        self._half_width, self._scene_from_local = half_width, scene_from_local
        film: dict[str, object] = {"type": "hdrfilm", "width": resolution, "height": resolution}
        film |= {"pixel_format": "rgba", "rfilter": {"type": "box"}}
        near = _NEAR * similarity_scale(scene_from_local)
        sensor = {"type": "orthographic", "film": film, "near_clip": near}
        self.scene = mi.load_dict({**scene, "sensor": sensor})
        # Transforms of softboxes depend on the lamp's size.
        transforms_as_parameters(self.scene.shapes())
        self._integrator = integrator

    def take(
        self,
        pose: NDArray[np.float64],
        spp: int,
        index: int,
        name: str,
        so_far: Callable[[Rendering], None] | None = None,
    ) -> Images:
        """Radiance and opacity of a view, as `shown_images`; `index` makes its random numbers.

        `so_far` is as for `render_passes`.
        """
        # Mitsuba's cameras look along +z, with x to the left.
        axes = np.diag([-self._half_width, self._half_width, -1, 1])
        parameters = mi.traverse(self.scene.sensors()[0])
        parameters["to_world"] = mi.Transform4f(self._scene_from_local @ pose @ axes)
        parameters.update()
        # A root seed has 31 bits.
        seed = SeedStream(Purpose.PREVIEW, index).seed(_ROOT_SEED) >> 1
        budget = Budget(spp)
        channels = render_passes(
            self.scene, self._integrator, budget, seed=seed, name=name, so_far=so_far
        ).channels
        return channels[..., :3], channels[..., 3]


def baked_view(asset: Asset, manifest: Manifest, frame: Frame) -> Images:
    """Radiance [H, W, 3] and opacity [H, W] of a baked luminaire in one view of a dataset."""
    return baked_image(asset, frame.pose, manifest.half_width, manifest.resolution)


def baked_image(
    asset: Asset, local_from_camera: NDArray[np.float64], half_width: float, resolution: int
) -> Images:
    """Orthographic image of a baked luminaire: its field, or its light field without one.

    Arguments, units and results as for `shown_images`.
    """
    device = DeviceAsset(asset)
    return image_of(
        lambda origin, towards: device.look(origin, towards, True, parallel=True),
        local_from_camera,
        half_width,
        resolution,
    )


def image_of(
    seen: Callable[[mi.Point3f, mi.Vector3f], tuple[mi.Color3f, mi.Float]],
    local_from_camera: NDArray[np.float64],
    half_width: float,
    resolution: int,
) -> Images:
    """Orthographic image, as `baked_image`, by radiance and transmittance of rays."""
    fine = resolution * RAYS_A_SIDE
    index = dr.arange(mi.UInt32, fine * fine)
    # Rays of one pixel have consecutive indices, so that a block sum averages them.
    pixel, sub = index // RAYS_A_SIDE**2, index % RAYS_A_SIDE**2
    column = (pixel % resolution) * RAYS_A_SIDE + sub % RAYS_A_SIDE
    row = (pixel // resolution) * RAYS_A_SIDE + sub // RAYS_A_SIDE
    step = 2 * half_width / fine
    pose = mi.Transform4f(local_from_camera)
    dr.make_opaque(pose)
    origin = pose @ mi.Point3f(
        (column + 0.5) * step - half_width,
        half_width - (row + 0.5) * step,
        0,
    )
    towards = -(pose @ mi.Vector3f(0, 0, 1))
    radiance, through = seen(origin, towards)
    # A block sum evaluates its argument. Without this, each channel would repeat the traversal.
    dr.eval(radiance, through)
    values = [dr.block_sum(value, RAYS_A_SIDE**2) for value in (*radiance, through)]
    dr.eval(values)
    image = np.stack([np.array(value, np.float32) for value in values], axis=-1)
    image /= RAYS_A_SIDE**2
    image = image.reshape(resolution, resolution, 4)
    return image[..., :3], 1 - image[..., 3]


def vertex_radiance(
    asset: Asset,
    vertices: NDArray[np.float32],
    faces: NDArray[np.uint32],
    samples_per_face: int,
    name: str = "surfaces",
    lights: Mapping[str, object] | None = None,
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
            start = parameter(mi.UInt32, first)
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
            known = (*colour, dr.square(channel_mean(colour)), mi.Float(1))
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
