"""Preview of a luminaire before it is baked, or of an asset: six views on a contact sheet."""

import dataclasses
import math
import time
from collections.abc import Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.directions import pose_towards
from lumitree.core.drawing import OPACITY, Sheet, Tile, image_grid
from lumitree.core.images import auto_exposure, tonemap
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.lamp.luminaire import Luminaire
from lumitree.rendering.asset_images import shown_images
from lumitree.rendering.studio import asset_photographs, luminaire_photographs
from lumitree.trace.cameras import Camera, ViewImages

# Direction from the luminaire to the camera, and the direction that is upwards in the image, in the
# frame of the luminaire's file, where y is up.
VIEWS = {
    "from the front, +z": ((0, 0, 1), (0, 1, 0)),
    "from the right, +x": ((1, 0, 0), (0, 1, 0)),
    "from the back, -z": ((0, 0, -1), (0, 1, 0)),
    "from the left, -x": ((-1, 0, 0), (0, 1, 0)),
    "from above, +y": ((0, 1, 0), (0, 0, -1)),
    "from below, -y": ((0, -1, 0), (0, 0, 1)),
}
_MIN_STOPS = 2
# Limits of the side of an image on the sheet, pixels.
_MIN_SIDE, _MAX_SIDE = 192, 640


@dataclasses.dataclass(frozen=True)
class Preview:
    """Images of a luminaire or of an asset.

    Attributes:
        images: by the names of `VIEWS`.
        photographs: of each view, sRGB bytes [H, W, 3], as `rendering.studio` makes them.
        paths_per_second: paths traced per second, without the time of compilation.
    """

    images: dict[str, ViewImages]
    photographs: Sequence[NDArray[np.uint8]]
    paths_per_second: float

    @property
    def radiance(self) -> NDArray[np.float32]:
        """Radiance [6, H, W, 3] of all images, W/(m² sr)."""
        return np.stack([image.radiance for image in self.images.values()])

    @property
    def exposure(self) -> float:
        """Exposure factor of all images, at which the emitters are well exposed."""
        return auto_exposure(self.radiance)

    @property
    def more_stops(self) -> int:
        """Whole stops above `exposure` at which the median of the lit pixels is middle grey.

        At this exposure the body of the lamp is visible. It is often a thousand times darker than
        the emitters.
        """
        brightest = self.radiance.max(axis=-1)
        lit = brightest[brightest > 0]
        if not lit.size:
            return _MIN_STOPS
        return max(round(math.log2(0.18 / float(np.median(lit)) / self.exposure)), _MIN_STOPS)


def take_preview(luminaire: Luminaire, resolution: int, spp: int) -> Preview:
    """Render the six views, with `resolution` pixels per side."""
    camera = Camera(luminaire, resolution, spp)
    images: dict[str, ViewImages] = {}
    seconds = []
    poses = _poses(luminaire.bounding_radius)
    with progress(f"preview {luminaire.name}", len(VIEWS)) as advance:
        for number, (name, pose) in enumerate(zip(VIEWS, poses, strict=True)):
            start = time.perf_counter()
            images[name] = camera.take(pose, SeedStream(Purpose.PREVIEW, number))
            seconds.append(time.perf_counter() - start)
            advance(1)
    # The first view is not counted, because its time includes compilation.
    paths = resolution**2 * spp * (len(VIEWS) - 1)
    preview = Preview(images, [], paths / sum(seconds[1:]))
    photographs = luminaire_photographs(luminaire, poses, resolution, spp, preview.exposure)
    return dataclasses.replace(preview, photographs=photographs)


def take_asset_preview(asset: Asset, resolution: int, spp: int) -> Preview:
    """Render the six views of an asset, with the camera of its luminaire's preview.

    Both opacities are the one of `shown_images`. The camera's sphere contains the bounding box.
    """
    radius = float(np.linalg.norm(asset.frame.half_extents))
    poses = _poses(radius)
    shown = shown_images(asset, poses, radius, resolution, spp)
    images = {
        name: ViewImages(radiance, opacity, opacity)
        for name, (radiance, opacity) in zip(VIEWS, shown, strict=True)
    }
    preview = Preview(images, [], 0.0)
    photographs = asset_photographs(asset, poses, radius, resolution, spp, preview.exposure)
    return dataclasses.replace(preview, photographs=photographs)


def _poses(radius: float) -> list[NDArray[np.float64]]:
    """`local_from_camera` [4, 4] of the views of a sphere of this radius, local units."""
    return [pose_towards(backward, up, 2 * radius) for backward, up in VIEWS.values()]


def draw_preview(
    preview: Preview, title: str, facts: Sequence[str], *, baked: bool = False
) -> Sheet:
    """Contact sheet with a column for each view; `facts` are in the line below the title.

    Rows: the lamp in soft light, its own radiance at two exposures, geometric opacity and
    straight-through opacity; of an asset, which is `baked`, the two are one.
    """
    exposure, stops, views = preview.exposure, preview.more_stops, preview.images.values()
    bright = exposure * 2**stops
    rows: dict[str, Sequence[NDArray[Any]]] = {
        "in soft light": preview.photographs,
        "radiance": [tonemap(view.radiance, exposure) for view in views],
        f"radiance, {stops} stops brighter": [tonemap(view.radiance, bright) for view in views],
        "opacity" if baked else "geometric opacity": [OPACITY(view.geometric) for view in views],
    }
    if not baked:
        rows["straight-through opacity"] = [OPACITY(view.straight_through) for view in views]
    return image_grid(
        [[Tile(image) for image in row] for row in rows.values()],
        min(max(preview.radiance.shape[1], _MIN_SIDE), _MAX_SIDE),
        title=title,
        subtitle="   ·   ".join([*facts, f"exposure {exposure:.3g} in all views"]),
        columns=list(preview.images),
        names=list(rows),
    )
