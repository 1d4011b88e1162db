"""Six views of a luminaire, before anything is baked: what is there, and does it look right?"""

import dataclasses
import math
import time
from collections.abc import Sequence

import numpy as np
from numpy.typing import NDArray

from lumitree.core.directions import pose_towards
from lumitree.core.images import auto_exposure, tonemap
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.evaluation.tiles import DARK, Layout, TileSheet, grey
from lumitree.luminaire.luminaire import Luminaire
from lumitree.views.camera import Camera, Picture

# Where the camera stands and what is upwards in its picture, in the luminaire's frame (y up).
VIEWS = {
    "from the front, +z": ((0, 0, 1), (0, 1, 0)),
    "from the right, +x": ((1, 0, 0), (0, 1, 0)),
    "from the back, -z": ((0, 0, -1), (0, 1, 0)),
    "from the left, -x": ((-1, 0, 0), (0, 1, 0)),
    "from above, +y": ((0, 1, 0), (0, 0, -1)),
    "from below, -y": ((0, -1, 0), (0, 0, 1)),
}
NUM_ROWS = 4
_MIN_STOPS = 2
_MIN_TILE, _MAX_TILE = 192, 640


@dataclasses.dataclass(frozen=True)
class Preview:
    """Pictures by the names of `VIEWS`, and paths traced per second (without compilation)."""

    pictures: dict[str, Picture]
    paths_per_second: float

    @property
    def radiance(self) -> NDArray[np.float32]:
        """Radiance of all pictures [6, H, W, 3]."""
        return np.stack([picture.radiance for picture in self.pictures.values()])

    @property
    def exposure(self) -> float:
        """One factor for all pictures, so that they can be compared; shows what emits."""
        return auto_exposure(self.radiance)

    @property
    def more_stops(self) -> int:
        """Whole stops above `exposure` that bring the lit pixels' median to middle grey.

        They show what is lit: a lamp's body is often a thousand times darker than its emitters.
        """
        brightest = self.radiance.max(axis=-1)
        lit = brightest[brightest > 0]
        if not lit.size:
            return _MIN_STOPS
        return max(round(math.log2(0.18 / float(np.median(lit)) / self.exposure)), _MIN_STOPS)


def take_preview(luminaire: Luminaire, resolution: int, samples_per_pixel: int) -> Preview:
    """Trace the six views; arguments as for a capture."""
    camera = Camera(luminaire, resolution, samples_per_pixel)
    pictures: dict[str, Picture] = {}
    seconds = []
    with progress(f"preview {luminaire.name}", len(VIEWS)) as advance:
        for number, (name, (backward, up)) in enumerate(VIEWS.items()):
            start = time.perf_counter()
            pose = pose_towards(backward, up, 2 * luminaire.bounding_radius)
            pictures[name] = camera.take(pose, SeedStream(Purpose.PREVIEW, number))
            seconds.append(time.perf_counter() - start)
            advance(1)
    # The first view also compiles.
    paths = resolution**2 * samples_per_pixel * (len(VIEWS) - 1)
    return Preview(pictures, paths / sum(seconds[1:]))


def preview_layout(resolution: int) -> Layout:
    """Layout of a preview; pixels are shown one to one where that is legible."""
    tile = min(max(resolution, _MIN_TILE), _MAX_TILE)
    return Layout(len(VIEWS), NUM_ROWS, tile, title=60, caption=6, side=30)


def draw_preview(preview: Preview, title: str, facts: Sequence[str]) -> TileSheet:
    """Draw the sheet: a column for each view, rows for radiance at two exposures and opacities.

    Args:
        title: name of the luminaire.
        facts: short ones, for the line below the title.
    """
    exposure, stops = preview.exposure, preview.more_stops
    sheet = TileSheet(preview_layout(preview.radiance.shape[1]), DARK)
    sheet.title(title, "   ·   ".join([*facts, f"exposure {exposure:.3g} in all views"]))
    rows = (
        ("radiance", lambda picture: tonemap(picture.radiance, exposure)),
        (
            f"radiance, {stops} stops brighter",
            lambda picture: tonemap(picture.radiance, exposure * 2**stops),
        ),
        ("geometric opacity", lambda picture: grey(picture.geometric)),
        ("straight-through opacity", lambda picture: grey(picture.straight_through)),
    )
    for column, name in enumerate(preview.pictures):
        sheet.heading(column, name)
    for row, (name, show) in enumerate(rows):
        sheet.row_name(row, name)
        for column, picture in enumerate(preview.pictures.values()):
            sheet.image(row, column, show(picture))
    return sheet
