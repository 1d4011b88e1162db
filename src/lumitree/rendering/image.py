"""Images as results, which are written to files."""

import dataclasses
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import check_sheet_output
from lumitree.core.files import FilePath, write_bytes
from lumitree.core.images import check_image_name, write_exr
from lumitree.core.photometry import luminance
from lumitree.core.results import ImageResult
from lumitree.errors import explained


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class SavedImage(ImageResult):
    """Base class of results with an image that can be written to a file.

    Attributes:
        pixels: float32 [height, width, 3], linear radiance, W/(m² sr).
        settings: what made the image, as JSON text; the comment of the files.
        ev: exposure value of `png`, EV100: 1.2 x 2^ev cd/m² is white.
        white_balance: colour temperature of light that `png` shows white, K; None for no
            adaptation.
    """

    pixels: NDArray[np.float32] = dataclasses.field(repr=False)
    settings: str = dataclasses.field(repr=False)
    ev: float
    white_balance: float | None

    @explained
    def save(self, path: FilePath) -> None:
        """Write the image.

        Args:
            path: path of the file, `.exr` (linear radiance) or `.png` (`png`).

        Raises:
            LumitreeError: the name has another ending, or the file cannot be written.
        """
        check_image_name(path)
        if Path(path).suffix.lower() == ".exr":
            write_exr(path, {"RGB": self.pixels}, self.settings)
        else:
            write_bytes(path, self.png)

    @property
    def luminance(self) -> NDArray[np.float64]:
        """Luminance [height, width], cd/m²."""
        return luminance(self.pixels)

    @explained
    def save_luminance(self, path: FilePath) -> None:
        """Write the luminance in false colours, with a legend in cd/m².

        Args:
            path: path of the file, `.png`.

        Raises:
            LumitreeError: the name has another ending, or the file cannot be written.
        """
        from lumitree.rendering.drawing import luminance_png

        check_sheet_output(path, "luminance image")
        write_bytes(path, luminance_png(self.luminance))
