"""Views of a baked luminaire, with the pixel filter of the captured ones."""

from __future__ import annotations

from collections.abc import Callable

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.lamp.dataset import Frame, Manifest
from lumitree.rendering.device import DeviceAsset

# Rays per pixel and side: 4 x 4 rays, stratified, with the box filter that capture uses.
RAYS_A_SIDE = 4


def baked_view(
    asset: Asset, manifest: Manifest, frame: Frame
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Radiance [H, W, 3] and opacity [H, W] of a baked luminaire in one view of a dataset."""
    return baked_image(asset, frame.pose, manifest.half_width, manifest.resolution)


def baked_image(
    asset: Asset, local_from_camera: NDArray[np.float64], half_width: float, resolution: int
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
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
