"""Images as results: written to files, and mixed from their layers."""

import dataclasses
from collections.abc import Mapping
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import check_gain, check_sheet_output
from lumitree.core.backend import in_turn
from lumitree.core.files import FilePath, write_bytes
from lumitree.core.images import (
    check_image_name,
    encode_png,
    image_settings,
    read_comment,
    read_exr,
    write_exr,
)
from lumitree.core.photometry import luminance
from lumitree.core.results import ImageResult, Stopwatch
from lumitree.errors import LumitreeError, explained, shown
from lumitree.rendering.photograph import PhotoSettings
from lumitree.rendering.view_transform import View

# W/(m² sr); sums over the pixels of an image are then finite in single precision.
_MAX_RADIANCE = 1e30


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


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class MixResult(SavedImage):
    """Image that was mixed from layers.

    Attributes:
        pixels: float32 [height, width, 3], linear radiance, W/(m² sr).
        settings: what made the image, as JSON text; the comment of the files.
        ev, white_balance: of `png`, as of `RenderResult`; automatic ones are of the layers without
            gains, so that a dimmed lamp looks dimmed.
        layers: names of the layers.
        resolution: width and height in pixels.
        mean_radiance: mean over pixels and channels, W/(m² sr).
    """

    layers: list[str]
    resolution: tuple[int, int]
    mean_radiance: float


@in_turn
def mix(
    layers: FilePath | Mapping[str, NDArray[np.float32]],
    gain: Mapping[str, float | tuple[float, float, float]] | None = None,
    *,
    exposure: float | str = 0.0,
    white_balance: float | str = "auto",
    view: View = "agx",
    bloom: float = 0.06,
) -> MixResult:
    """Change the brightness and the colour of lamps in an image, without rendering it again.

    Args:
        layers: `RenderResult.layers`, arrays [height, width, 3] of linear radiance by name; or the
            path of a file that `RenderResult.save_layers` has written.
        gain: by name of the layer, factors [3] on R, G and B of its light, or one number for all;
            0 to 10⁶. Default: 1.
        exposure: of `png`, as for `render`. Automatic is by the layers without gains, so that a
            dimmed lamp looks dimmed.
        white_balance: of `png`, as for `render`. Automatic is by the layers without gains.
        view: view transform of `png`, as for `render`.
        bloom: of `png`, as for `render`.

    Returns:
        The image as `pixels`, float32 [height, width, 3], linear radiance in W/(m² sr), and
        as `png`. `MixResult.save` writes it.

    Raises:
        LumitreeError: the file is missing, damaged or has no layers; a gain is out of range or
            of a layer that there is not; or `exposure` or `white_balance` is out of range.
    """
    settings = PhotoSettings(exposure=exposure, white_balance=white_balance, view=view, bloom=bloom)
    factors = {name: check_gain(each) for name, each in (gain or {}).items()}
    watch = Stopwatch()
    with watch.stage("mix"):
        if isinstance(layers, Mapping):
            what, file, colours, rendered = "the image", None, dict(layers), None
        else:
            what, file = shown(layers), Path(layers).name
            colours, rendered = read_exr(layers), read_comment(layers)
        shapes = {np.shape(colour) for colour in colours.values()}
        alike = len(shapes) == 1 and all(len(s) == 3 and s[2] == 3 for s in shapes)
        # Other files have other channels too, such as AOVs.
        if not alike or (file is not None and "RGB" in colours):
            raise LumitreeError(
                f"{what} is not made of layers only; expected channels NAME.R, NAME.G and NAME.B "
                "of each, as `lumitree render --layers` writes them"
            )
        for name in factors.keys() - colours.keys():
            raise LumitreeError(
                f"{what} has no layer {shown(repr(name), 100)}; it has "
                f"{shown(', '.join(sorted(colours)), 300)}"
            )
        # Overflow is refused below.
        with np.errstate(over="ignore", invalid="ignore"):
            scaled = [
                colour * np.array(factors.get(name, (1, 1, 1)), np.float32)
                for name, colour in colours.items()
            ]
            pixels = np.sum(scaled, axis=0)
        if not (np.abs(pixels) <= _MAX_RADIANCE).all():
            raise LumitreeError(
                f"the layers of {what} have radiance above {_MAX_RADIANCE:g} W/(m² sr) with these "
                "gains; render them again, or use smaller gains"
            )
    rendered_pixels = np.stack(list(colours.values())).sum(axis=0, dtype=np.float64)
    photograph = settings.photograph(pixels, metered=rendered_pixels)
    comment = image_settings(
        "mix", layers=file, gain=factors, **photograph.described(settings), rendered=rendered
    )
    return MixResult(
        pixels=pixels,
        settings=comment,
        layers=sorted(colours),
        resolution=(pixels.shape[1], pixels.shape[0]),
        mean_radiance=float(pixels.mean()),
        ev=photograph.ev,
        white_balance=photograph.white_balance,
        png=encode_png(photograph.pixels, comment),
        **watch.costs(),
    )
