"""Lamps as a catalogue shows them: lit softly from around, with their own light added.

By its own light alone most of a lamp is black: its metal and glass have nothing to reflect.
"""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.frames import pose_towards
from lumitree.core.images import auto_exposure, tonemap
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.scene_shapes import reusable_shapes
from lumitree.rendering.asset_images import (
    LampCamera,
    asset_scene,
    geometry_integrator,
    shown_images,
)
from lumitree.trace.cameras import PATH_DEPTH, path_integrator

# Radiance of the backdrop and of the softboxes, relative to white; and how much brighter the lamp's
# own light is than at its automatic exposure.
BACKDROP, SOFTBOX, OWN = 0.125, 3.0, 2.0
# Directions of the softboxes from the lamp, their distance and half their sides, in half sides of
# the image: none of them is in the image.
_DIRECTIONS = tuple(
    np.array(each) / np.linalg.norm(each)
    for each in ((1, 0.7, 1), (-1, 0.7, 1), (1, 0.7, -1), (-1, 0.7, -1))
)
_DISTANCE, _HALF_WIDTH, _HALF_HEIGHT = 5.05, 1.0, 1.58
# Direction from the lamp to the camera of a portrait, and width of the image over the lamp's.
_PORTRAIT, _MARGIN = (0.4, 0.25, 0.882), 1.06
_SAME = np.eye(4)


def asset_photographs(
    asset: Asset,
    poses: Sequence[NDArray[np.float64]],
    half_width: float,
    resolution: int,
    spp: int,
    exposure: float | None = None,
) -> list[NDArray[np.uint8]]:
    """sRGB images [H, W, 3] of an asset, before a grey backdrop.

    Softboxes light its geometry. A field, which reflects nothing, has the backdrop alone.

    Args:
        poses, half_width, resolution, spp: as for `shown_images`.
        exposure: factor on the radiance. Default: `auto_exposure` of the first image.
    """
    if asset.geometry is None:
        shown = shown_images(asset, poses, half_width, resolution, spp)
        factor = OWN * (auto_exposure(shown[0][0]) if exposure is None else exposure)
        return [
            tonemap(radiance * factor + BACKDROP * (1 - opacity[..., None]))
            for radiance, opacity in shown
        ]
    studio = _Studio(asset_scene(asset), geometry_integrator(), half_width, resolution)
    return studio.photographs(poses, spp, exposure, asset.luminaire)


def luminaire_photographs(
    luminaire: Luminaire,
    poses: Sequence[NDArray[np.float64]],
    resolution: int,
    spp: int,
    exposure: float,
) -> list[NDArray[np.uint8]]:
    """As `asset_photographs`, of a luminaire in its bounding sphere."""
    shapes = {f"shape{i}": each for i, each in enumerate(reusable_shapes(luminaire.scene))}
    studio = _Studio(
        {"type": "scene", **shapes},
        path_integrator(luminaire, PATH_DEPTH),
        luminaire.bounding_radius,
        resolution,
        luminaire.scene_frame.world_from_local,
    )
    return studio.photographs(poses, spp, exposure, luminaire.name)


def portrait(asset: Asset, resolution: int, spp: int) -> NDArray[np.uint8]:
    """sRGB image [H, W, 3] of an asset from obliquely in front, which its box fills."""
    pose = pose_towards(_PORTRAIT, (0, 1, 0), 4.0)
    half_width = portrait_half_width(asset)
    return asset_photographs(asset, [pose], half_width, resolution, spp)[0]


def portrait_half_width(asset: Asset) -> float:
    """Half the side of a portrait, local units."""
    # Half the width of the bounding box as the camera sees it.
    seen = np.abs(pose_towards(_PORTRAIT, (0, 1, 0), 4.0)[:3, :2].T) @ asset.frame.half_extents
    return _MARGIN * float(seen.max())


def softboxes(half_width: float) -> list[NDArray[np.float64]]:
    """Rectangles from -1 to 1 that light a lamp, as [4, 4] `local_from_rectangle`.

    They emit along their +z, and are dark behind.

    Args:
        half_width: half the side of the image, local units.
    """
    # Turned away from where a camera at such a pose looks.
    shape = np.diag([_HALF_WIDTH * half_width, -_HALF_HEIGHT * half_width, -1, 1])
    return [
        pose_towards(direction, (0, 1, 0), _DISTANCE * half_width) @ shape
        for direction in _DIRECTIONS
    ]


def studio_lights(
    half_width: float, white: float, scene_from_local: NDArray[np.float64] = _SAME
) -> dict[str, Any]:
    """The backdrop and the softboxes, for `mi.load_dict`.

    Args:
        half_width: half the side of the image, local units.
        white: radiance of white, W/(m² sr).
        scene_from_local: [4, 4]. Default: the frame of the scene is the local one.
    """
    lights: dict[str, Any] = {"backdrop": _emitter("constant", BACKDROP * white)}
    for number, local_from_rectangle in enumerate(softboxes(half_width)):
        lights[f"softbox{number}"] = {
            "type": "rectangle",
            "to_world": mi.ScalarTransform4f(scene_from_local @ local_from_rectangle),
            "emitter": _emitter("area", SOFTBOX * white),
        }
    return lights


class _Studio:
    """A lamp between softboxes; arguments as of `LampCamera`."""

    def __init__(
        self,
        lamp: Mapping[str, Any],
        integrator: mi.Integrator,
        half_width: float,
        resolution: int,
        scene_from_local: NDArray[np.float64] = _SAME,
    ) -> None:
        lights = studio_lights(half_width, 0.0, scene_from_local)
        scene = {**lamp, **lights}
        self._camera = LampCamera(scene, integrator, half_width, resolution, scene_from_local)

    def photographs(
        self,
        poses: Sequence[NDArray[np.float64]],
        spp: int,
        exposure: float | None,
        name: str,
    ) -> list[NDArray[np.uint8]]:
        name = f"preview {name}"
        if exposure is None:
            # The same scene, whose kernel is compiled once.
            exposure = auto_exposure(self._camera.take(poses[0], spp, 0, name)[0])
        self._light(1 / (OWN * exposure))
        return [
            tonemap(self._camera.take(pose, spp, index, name)[0], OWN * exposure)
            for index, pose in enumerate(poses)
        ]

    def _light(self, level: float) -> None:
        """Switch the studio on; white is a radiance of `level`, W/(m² sr)."""
        parameters = mi.traverse(self._camera.scene)
        parameters["backdrop.radiance.value"] = BACKDROP * level
        for number in range(len(_DIRECTIONS)):
            parameters[f"softbox{number}.emitter.radiance.value"] = SOFTBOX * level
        parameters.update()


def _emitter(kind: str, radiance: float) -> dict[str, Any]:
    return {"type": kind, "radiance": {"type": "rgb", "value": radiance}}
