"""Images mixed from the layers of an image: other brightness and colour of each lamp."""

import dataclasses
import warnings
from collections.abc import Mapping
from fnmatch import fnmatchcase
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import check_gain
from lumitree.core.backend import in_turn
from lumitree.core.files import FilePath, write_bytes
from lumitree.core.images import (
    check_image_name,
    encode_png,
    image_settings,
    read_comment,
    read_exr,
)
from lumitree.core.results import Stopwatch
from lumitree.errors import LumitreeError, LumitreeWarning, explained, shown
from lumitree.rendering.image import SavedImage
from lumitree.rendering.photograph import Highlights, PhotoSettings
from lumitree.rendering.render import RenderResult
from lumitree.rendering.view_transform import View

# W/(m² sr); sums over the pixels of an image are then finite in single precision.
_MAX_RADIANCE = 1e30


@dataclasses.dataclass(frozen=True)
class ImageLayers:
    """The layers of an image.

    Attributes:
        light: by name, [H, W, 3], radiance, W/(m² sr), without negative values.
        highlights: by name, light of emitters that the camera sees, a part of `light`; of layers
            that have any.
        what: what they are, for messages.
        file: name of their file; None for arrays.
        rendered: settings of the image, as JSON text; None if they are not known.
    """

    light: dict[str, NDArray[np.float32]]
    highlights: dict[str, Highlights]
    what: str = "the image"
    file: str | None = None
    rendered: str | None = None

    @staticmethod
    def of(layers: FilePath | Mapping[str, NDArray[np.float32]] | RenderResult) -> "ImageLayers":
        """The layers that `mix` was given."""
        if isinstance(layers, RenderResult):
            found = ImageLayers(layers.layers, layers.layer_highlights, rendered=layers.settings)
        elif isinstance(layers, Mapping):
            found = ImageLayers(dict(layers), {})
        else:
            found = _read(layers)
        shapes = {np.shape(colour) for colour in found.light.values()}
        alike = len(shapes) == 1 and all(len(s) == 3 and s[2] == 3 and min(s) for s in shapes)
        # Other files have other channels too, such as AOVs.
        if not alike or (found.file is not None and "RGB" in found.light):
            raise LumitreeError(
                f"{found.what} is not made of layers only; expected channels NAME.R, NAME.G and "
                "NAME.B of each, as `lumitree render --layers` writes them"
            )
        if part := float(np.mean([light < 0 for light in found.light.values()])):
            warnings.warn(
                f"{part:.2g} of the numbers in {found.what} are negative, and count as 0; "
                "reconstruction filters with negative lobes, or other programs, give such radiance",
                LumitreeWarning,
                stacklevel=4,
            )
        light = {name: np.maximum(light, 0) for name, light in found.light.items()}
        return dataclasses.replace(found, light=light)

    def mixed(
        self, gain: Mapping[str, tuple[float, float, float]]
    ) -> tuple[NDArray[np.float32], Highlights | None]:
        """Radiance [H, W, 3] with factors on R, G and B of layers, and its highlights."""
        factors = {name: np.array(gain.get(name, (1, 1, 1)), np.float32) for name in self.light}
        # Overflow is refused by `mix`.
        with np.errstate(over="ignore", invalid="ignore"):
            pixels = np.sum([self.light[name] * each for name, each in factors.items()], axis=0)
            parts = [each.scaled(factors[name]) for name, each in self.highlights.items()]
            if not parts:
                return pixels, None
            seen = np.sum([each.seen for each in parts], axis=0)
            return pixels, Highlights(seen, np.sum([each.square for each in parts], axis=0))


def _read(path: FilePath) -> ImageLayers:
    """The layers of a file of `RenderResult.save_layers`, also of versions without highlights."""
    channels = read_exr(path)
    highlights = {}
    for name in [name for name in channels if {f"{name}.seen", f"{name}.square"} <= {*channels}]:
        parts = channels.pop(f"{name}.seen"), channels.pop(f"{name}.square")
        highlights[name] = Highlights(*parts)
    return ImageLayers(channels, highlights, shown(path), Path(path).name, read_comment(path))


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
    _layers: ImageLayers = dataclasses.field(repr=False)
    _gain: dict[str, tuple[float, float, float]] = dataclasses.field(repr=False)
    _photo: PhotoSettings = dataclasses.field(repr=False)

    @explained
    def save(self, path: FilePath) -> None:
        """Write the image, or a web page with a dimmer for each layer, which begins as this image.

        Args:
            path: path of the file, `.exr` (linear radiance), `.png` (`png`) or `.html` (the page,
                which needs no other file and no network).

        Raises:
            LumitreeError: the name has another ending, the file cannot be written, or there are
                too many layers or pixels for a page.
        """
        check_image_name(path, page=True)
        if Path(path).suffix.lower() != ".html":
            super().save(path)
            return
        from lumitree.viewer.dimmers import dimmer_page

        given = self._layers
        page = dimmer_page(
            given.light,
            given.highlights,
            self._gain,
            self._photo,
            self.ev,
            file=given.file,
            rendered=given.rendered,
        )
        write_bytes(path, page.encode())


@in_turn
def mix(
    layers: FilePath | Mapping[str, NDArray[np.float32]] | RenderResult,
    gain: Mapping[str, float | tuple[float, float, float]] | None = None,
    *,
    exposure: float | str = 0.0,
    white_balance: float | str = "auto",
    view: View = "agx",
    bloom: float = 0.06,
) -> MixResult:
    """Change the brightness and the colour of lamps in an image, without rendering it again.

    Args:
        layers: the path of a file that `RenderResult.save_layers` has written; a `RenderResult`
            with layers; or arrays [height, width, 3] of linear radiance by name, whose emitters
            are not clamped before pixels are averaged. Negative radiance counts as 0.
        gain: by name of the layer, or by a pattern with * and ? as `hall*`, factors [3] on R, G
            and B of its light, or one number for all; 0 to 10⁶. Default: 1.
        exposure: of `png`, as for `render`. Automatic is by the layers without gains, so that a
            dimmed lamp looks dimmed.
        white_balance: of `png`, as for `render`. Automatic is by the layers without gains.
        view: view transform of `png`, as for `render`.
        bloom: of `png`, as for `render`.

    Returns:
        The image as `pixels`, float32 [height, width, 3], linear radiance in W/(m² sr), and
        as `png`. `MixResult.save` writes it, or a web page with a dimmer for each layer.

    Raises:
        LumitreeError: the file is missing, damaged or has no layers; a gain is out of range or
            of a layer that there is not; or `exposure` or `white_balance` is out of range.
    """
    settings = PhotoSettings(exposure=exposure, white_balance=white_balance, view=view, bloom=bloom)
    watch, factors = Stopwatch(), dict[str, tuple[float, float, float]]()
    with watch.stage("mix"):
        given = ImageLayers.of(layers)
        for name, each in (gain or {}).items():
            names = [layer for layer in given.light if layer == name or fnmatchcase(layer, name)]
            if not names:
                raise LumitreeError(
                    f"{given.what} has no layer {shown(repr(name), 100)}; it has "
                    f"{shown(', '.join(sorted(given.light)), 300)}"
                )
            factors |= dict.fromkeys(names, check_gain(each))
        pixels, highlights = given.mixed(factors)
        if not (np.abs(pixels) <= _MAX_RADIANCE).all():
            raise LumitreeError(
                f"the layers of {given.what} have radiance that is not finite, or above "
                f"{_MAX_RADIANCE:g} W/(m² sr) with these gains; render them again, or use smaller "
                "gains"
            )
    rendered = np.stack(list(given.light.values())).sum(axis=0, dtype=np.float64)
    photograph = settings.photograph(pixels, metered=rendered, highlights=highlights)
    comment = image_settings(
        "mix",
        layers=given.file,
        gain=factors,
        **photograph.described(settings),
        rendered=given.rendered,
    )
    return MixResult(
        pixels=pixels,
        settings=comment,
        layers=sorted(given.light),
        resolution=(pixels.shape[1], pixels.shape[0]),
        mean_radiance=float(pixels.mean()),
        ev=photograph.ev,
        white_balance=photograph.white_balance,
        png=encode_png(photograph.pixels, comment),
        _layers=given,
        _gain=factors,
        _photo=settings,
        **watch.costs(),
    )
