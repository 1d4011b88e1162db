"""Lamps as a catalogue shows them: lit softly from around, with their own light added.

By its own light alone most of a lamp is black: its metal and glass have nothing to reflect.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence

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
from lumitree.rendering.layers import denoised_pixels
from lumitree.rendering.photograph import (
    Photograph,
    ev_of_white,
    exposure_value,
    white_radiance,
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
# Samples of a portrait over the samples of the image of its own light, by which it is exposed.
_METERING = 4
_SAME = np.eye(4)


def asset_photographs(
    asset: Asset,
    poses: Sequence[NDArray[np.float64]],
    half_width: float,
    resolution: int,
    spp: int,
    exposure: float,
) -> list[NDArray[np.uint8]]:
    """sRGB images [H, W, 3] of an asset, before a grey backdrop.

    Softboxes light its geometry. A field, which reflects nothing, has the backdrop alone.

    Args:
        poses, half_width, resolution, spp: as for `shown_images`.
        exposure: factor on the radiance.
    """
    if asset.geometry is None:
        shown = shown_images(asset, poses, half_width, resolution, spp)
        return [_before_backdrop(*each, exposure) for each in shown]
    studio = _asset_studio(asset, half_width, resolution)
    return studio.photographs(poses, spp, exposure, asset.luminaire)


def _before_backdrop(
    radiance: NDArray[np.float32], opacity: NDArray[np.float32], exposure: float
) -> NDArray[np.uint8]:
    return tonemap(radiance * OWN * exposure + BACKDROP * (1 - opacity[..., None]))


def _asset_studio(asset: Asset, half_width: float, resolution: int) -> _Studio:
    return _Studio(asset_scene(asset), geometry_integrator(), half_width, resolution)


def luminaire_photographs(
    luminaire: Luminaire,
    poses: Sequence[NDArray[np.float64]],
    resolution: int,
    spp: int,
    exposure: float,
) -> list[NDArray[np.uint8]]:
    """As `asset_photographs`, of a luminaire in its bounding sphere."""
    studio = _luminaire_studio(luminaire, luminaire.bounding_radius, resolution)
    return studio.photographs(poses, spp, exposure, luminaire.name)


def _luminaire_studio(luminaire: Luminaire, half_width: float, resolution: int) -> _Studio:
    shapes = {f"shape{i}": each for i, each in enumerate(reusable_shapes(luminaire.scene))}
    return _Studio(
        {"type": "scene", **shapes},
        path_integrator(luminaire, PATH_DEPTH),
        half_width,
        resolution,
        luminaire.scene_frame.world_from_local,
    )


def portrait(
    lamp: Asset | Luminaire,
    resolution: int,
    spp: int,
    exposure: float | str = 0.0,
    so_far: Callable[[Photograph], object] | None = None,
) -> Photograph:
    """Photograph of a lamp from obliquely in front, which its box fills.

    It is denoised if the optional dependency `denoise` is installed.

    Args:
        resolution, spp: as for `shown_images`.
        exposure: as for `lumitree.preview`.
        so_far: called with the photograph so far, as of `render_passes`.
    """
    pose, half_width = pose_towards(_PORTRAIT, (0, 1, 0), 4.0), portrait_half_width(lamp)
    if isinstance(lamp, Luminaire):
        name, studio = lamp.name, _luminaire_studio(lamp, half_width, resolution)
    elif lamp.geometry is None:
        ((radiance, opacity),) = shown_images(lamp, [pose], half_width, resolution, spp)
        ev = lamp_ev(exposure, lambda: radiance)
        return Photograph(_before_backdrop(radiance, opacity, 1 / white_radiance(ev)), ev, None)
    else:
        name, studio = lamp.luminaire, _asset_studio(lamp, half_width, resolution)
    ev = lamp_ev(exposure, lambda: studio.lamp_light(pose, max(1, spp // _METERING), name))

    def seen(pixels: NDArray[np.uint8]) -> None:
        if so_far is not None:
            so_far(Photograph(pixels, ev, None))

    (pixels,) = studio.photographs([pose], spp, 1 / white_radiance(ev), name, seen)
    return Photograph(denoised_pixels(pixels), ev, None)


def lamp_ev(exposure: float | str, light: Callable[[], NDArray[np.floating]]) -> float:
    """EV100 of an exposure, as for `lumitree.preview`; the automatic one shows emitters well.

    Args:
        light: returns the radiance of the lamp's own light, W/(m² sr).
    """
    return exposure_value(exposure, lambda: ev_of_white(1 / auto_exposure(light())))


def portrait_half_width(lamp: Asset | Luminaire) -> float:
    """Half the side of a portrait, local units."""
    # Half the width of the bounding box as the camera sees it.
    seen = np.abs(pose_towards(_PORTRAIT, (0, 1, 0), 4.0)[:3, :2].T) @ lamp.frame.half_extents
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
) -> dict[str, object]:
    """The backdrop and the softboxes, for `mi.load_dict`.

    Args:
        half_width: half the side of the image, local units.
        white: radiance of white, W/(m² sr).
        scene_from_local: [4, 4]. Default: the frame of the scene is the local one.
    """
    lights: dict[str, object] = {"backdrop": _emitter("constant", BACKDROP * white)}
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
        lamp: Mapping[str, object],
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
        exposure: float,
        name: str,
        so_far: Callable[[NDArray[np.uint8]], None] = lambda _: None,
    ) -> list[NDArray[np.uint8]]:
        def photograph(radiance: NDArray[np.float32]) -> NDArray[np.uint8]:
            return tonemap(radiance, OWN * exposure)

        self._light(1 / (OWN * exposure))
        return [
            photograph(
                self._camera.take(
                    pose,
                    spp,
                    index,
                    f"preview {name}",
                    lambda image: so_far(photograph(image.radiance)),
                )[0]
            )
            for index, pose in enumerate(poses)
        ]

    def lamp_light(self, pose: NDArray[np.float64], spp: int, name: str) -> NDArray[np.float32]:
        """Radiance of the lamp before the studio is switched on, by the same kernel."""
        return self._camera.take(pose, spp, 0, f"exposure of {name}")[0]

    def _light(self, level: float) -> None:
        """Switch the studio on; white is a radiance of `level`, W/(m² sr)."""
        parameters = mi.traverse(self._camera.scene)
        parameters["backdrop.radiance.value"] = BACKDROP * level
        for number in range(len(_DIRECTIONS)):
            parameters[f"softbox{number}.emitter.radiance.value"] = SOFTBOX * level
        parameters.update()


def _emitter(kind: str, radiance: float) -> dict[str, object]:
    return {"type": kind, "radiance": {"type": "rgb", "value": radiance}}
