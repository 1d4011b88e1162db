"""Images of an asset with nothing around it: its geometry, its field, or else its light field."""

from __future__ import annotations

import dataclasses
from collections.abc import Mapping, Sequence
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset, light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.core.device import transforms_as_parameters
from lumitree.core.frames import similarity_scale
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.rendering.asset_views import baked_image
from lumitree.rendering.passes import Budget, render_passes
from lumitree.rendering.register import shape
from lumitree.trace.cameras import PATH_DEPTH

# Equal settings give equal images: there is no option for the seed.
_ROOT_SEED = 0
# Distance from a camera to the nearest surface that it sees, local units.
_NEAR = 1e-3
_SAME = np.eye(4)

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


def asset_scene(asset: Asset) -> dict[str, Any]:
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
        scene: Mapping[str, Any],
        integrator: mi.Integrator,
        half_width: float,
        resolution: int,
        scene_from_local: NDArray[np.float64] = _SAME,
    ) -> None:
        self._half_width, self._scene_from_local = half_width, scene_from_local
        film: dict[str, Any] = {"type": "hdrfilm", "width": resolution, "height": resolution}
        film |= {"pixel_format": "rgba", "rfilter": {"type": "box"}}
        near = _NEAR * similarity_scale(scene_from_local)
        sensor = {"type": "orthographic", "film": film, "near_clip": near}
        self.scene = mi.load_dict({**scene, "sensor": sensor})
        # Those of softboxes depend on the lamp's size.
        transforms_as_parameters(self.scene.shapes())
        self._integrator = integrator

    def take(self, pose: NDArray[np.float64], spp: int, index: int, name: str) -> Images:
        """Radiance and opacity of a view, as `shown_images`; `index` makes its random numbers."""
        # Mitsuba's cameras look along +z, with x to the left.
        axes = np.diag([-self._half_width, self._half_width, -1, 1])
        parameters = mi.traverse(self.scene.sensors()[0])
        parameters["to_world"] = mi.Transform4f(self._scene_from_local @ pose @ axes)
        parameters.update()
        # A root seed has 31 bits.
        seed = SeedStream(Purpose.PREVIEW, index).seed(_ROOT_SEED) >> 1
        budget = Budget(spp)
        channels = render_passes(
            self.scene, self._integrator, budget, seed=seed, name=name
        ).channels
        return channels[..., :3], channels[..., 3]
