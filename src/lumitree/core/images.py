"""OpenEXR and PNG files, the settings that they state, and the sRGB transfer function."""

import contextlib
import io
import json
import os
from collections.abc import Iterable, Iterator
from pathlib import Path

import numpy as np
import OpenEXR
from numpy.typing import ArrayLike, NDArray
from PIL import Image
from PIL.PngImagePlugin import PngInfo

from lumitree._version import __version__
from lumitree.core.file_kinds import EXR, what_it_is
from lumitree.core.files import atomic_path
from lumitree.core.results import Json, plain
from lumitree.errors import LumitreeError, shown

# Largest side of an image that is read, pixels.
MAX_SIDE = 1 << 14
# Most values of all channels together: 8 GiB once they are read. A file of equal values is a
# thousandth of that.
_MAX_VALUES = 1 << 31


def write_exr(
    path: str | os.PathLike[str], channels: dict[str, NDArray[np.float32]], settings: str = ""
) -> None:
    """Write channels [H, W], and "RGB" or layers [H, W, 3], as a 32-bit OpenEXR file, atomically.

    `settings` are stored as the attribute "comments", if there are any.
    """
    header = {"compression": OpenEXR.ZIP_COMPRESSION, "type": OpenEXR.scanlineimage}
    if settings:
        header["comments"] = settings
    planes = {name: np.ascontiguousarray(value, np.float32) for name, value in channels.items()}
    with atomic_path(path) as temporary:
        try:
            OpenEXR.File(header, planes).write(str(temporary))
        except RuntimeError as error:
            raise OSError(None, _one_line(error)) from error


def read_exr(path: str | os.PathLike[str]) -> dict[str, NDArray[np.float32]]:
    """Channels of an OpenEXR file by name; R, G and B are combined as "RGB" [H, W, 3].

    Channels of a layer, such as "lamp.R", are combined under its name.

    Raises:
        LumitreeError: the file is missing, damaged or holds values that are not finite.
    """
    if not Path(path).is_file():
        raise LumitreeError(f"{path} does not exist; expected an OpenEXR image")
    _read_header(path)
    try:
        with _silent(), OpenEXR.File(str(path)) as file:
            if not file.parts:
                raise ValueError("its pixels are damaged, or cut off; write it again")
            planes = {
                name: np.asarray(channel.pixels, np.float32)
                for name, channel in file.channels().items()
            }
    except (RuntimeError, ValueError) as error:
        raise LumitreeError(f"{path} is not a readable OpenEXR image: {_one_line(error)}") from None
    for name, plane in planes.items():
        if not np.isfinite(plane).all():
            raise LumitreeError(f"{path}: channel {name} holds NaN or infinity")
    return planes


def read_comment(path: str | os.PathLike[str]) -> str | None:
    """The attribute "comments" of an OpenEXR file; None if there is none.

    Raises:
        LumitreeError: the file is damaged.
    """
    comment = _read_header(path).get("comments")
    return comment if isinstance(comment, str) else None


def srgb_from_linear(linear: ArrayLike) -> NDArray[np.floating]:
    """sRGB-encoded values in [0, 1] of linear values, which are clipped to [0, 1].

    The transfer function of IEC 61966-2-1, for each value. Arrays of single precision keep
    their type.
    """
    linear = np.clip(linear, 0.0, 1.0)
    return np.where(linear <= 0.0031308, 12.92 * linear, 1.055 * linear ** (1 / 2.4) - 0.055)


def linear_from_srgb(encoded: ArrayLike) -> NDArray[np.floating]:
    """Linear values in [0, 1] of sRGB-encoded values in [0, 1]: inverse of `srgb_from_linear`."""
    encoded = np.asarray(encoded)
    return np.where(encoded <= 0.04045, encoded / 12.92, ((encoded + 0.055) / 1.055) ** 2.4)


def resized(values: NDArray[np.float32], height: int, width: int) -> NDArray[np.float32]:
    """Values [H, W, C] in another size, interpolated linearly."""
    planes = [
        Image.fromarray(np.ascontiguousarray(values[..., at], np.float32)).resize(
            (width, height), Image.Resampling.BILINEAR
        )
        for at in range(values.shape[2])
    ]
    return np.stack([np.asarray(plane) for plane in planes], axis=-1)


def tonemap(radiance: NDArray[np.floating], exposure: float = 1.0) -> NDArray[np.uint8]:
    """sRGB bytes [..., 3] of linear radiance [..., 3], clipped at 1 after `exposure`."""
    linear = np.nan_to_num(np.asarray(radiance) * exposure, nan=0.0)
    return np.round(srgb_from_linear(linear) * 255).astype(np.uint8)


def auto_exposure(radiance: NDArray[np.floating]) -> float:
    """Exposure factor that maps the 98th percentile of the lit pixels' largest channel to 0.9."""
    brightest = np.asarray(radiance).max(axis=-1)
    lit = brightest[(brightest > 0) & np.isfinite(brightest)]
    return float(0.9 / np.percentile(lit, 98)) if lit.size else 1.0


def block_means(pixels: NDArray[np.float64], side: int) -> NDArray[np.float64]:
    """Means over blocks of `side` x `side` pixels of [H, W]; those at two edges may be smaller."""
    for axis, size in enumerate(pixels.shape):
        starts = np.arange(0, size, side)
        counts = np.diff(starts, append=size)
        pixels = np.add.reduceat(pixels, starts, axis=axis) / np.expand_dims(counts, 1 - axis)
    return pixels


def max_radiance(images: Iterable[NDArray[np.floating]]) -> float:
    """L_max: the 99.99th percentile over the pixels of all images [..., 3], largest channel.

    A few outliers ("fireflies") among a million pixels do not raise it.
    """
    largest = np.concatenate([np.asarray(image).max(axis=-1).ravel() for image in images])
    return float(np.percentile(largest, 99.99, overwrite_input=True))


def encode_png(pixels: NDArray[np.uint8], settings: str = "") -> bytes:
    """A PNG file of sRGB bytes [H, W, 3], with the comment `settings` if there are any."""
    stream, text = io.BytesIO(), PngInfo()
    if settings:
        text.add_itxt("Comment", settings)
    Image.fromarray(pixels).save(stream, format="PNG", optimize=True, pnginfo=text)
    return stream.getvalue()


def check_image_name(path: str | os.PathLike[str], *, page: bool = False) -> None:
    """Refuse a name of an image, or of a page, whose format is not known by it."""
    suffix = Path(path).suffix.lower()
    if suffix not in (".exr", ".png") and not (page and suffix == ".html"):
        raise LumitreeError(
            f"image name {str(path)!r} ends in neither .exr (linear) nor .png (for displays)"
            + ", nor .html (with dimmers)" * page
        )


def check_exr_name(path: str | os.PathLike[str]) -> None:
    """Refuse a name of a file of layers or buffers, which are linear, that is not of OpenEXR."""
    if Path(path).suffix.lower() != ".exr":
        raise LumitreeError(
            f"{shown(repr(str(path)), 300)} does not end in .exr; layers and buffers are linear"
        )


def _read_header(path: str | os.PathLike[str]) -> Json:
    """Header of an OpenEXR file; refuses sizes for which memory would be reserved in vain."""
    try:
        with _silent(), OpenEXR.File(str(path), header_only=True) as file:
            # A copy: the file empties its header when it is closed.
            header = dict(file.header())
            lower, upper = (np.asarray(corner, np.int64) for corner in header["dataWindow"])
            channels = len(header["channels"])
    except (RuntimeError, ValueError, KeyError) as error:
        what = what_it_is(path)
        reason = _one_line(error) if what in (None, EXR) else f"it is {what}"
        raise LumitreeError(f"{path} is not a readable OpenEXR image: {reason}") from None
    width, height = (upper - lower + 1).tolist()
    if not (1 <= width <= MAX_SIDE and 1 <= height <= MAX_SIDE):
        raise LumitreeError(
            f"{path} has {width} x {height} pixels; expected an image of 1 to {MAX_SIDE} a side"
        )
    if width * height * channels > _MAX_VALUES:
        raise LumitreeError(
            f"{path} has {channels} channels of {width} x {height} pixels; expected at most "
            f"{_MAX_VALUES} values"
        )
    return header


@contextlib.contextmanager
def _silent() -> Iterator[None]:
    """OpenEXR prints, by Python and by C, what is wrong with a file."""
    with open(os.devnull, "w", encoding="utf-8") as nowhere, contextlib.redirect_stdout(nowhere):
        kept = os.dup(2)
        os.dup2(nowhere.fileno(), 2)
        try:
            yield
        finally:
            os.dup2(kept, 2)
            os.close(kept)


def _one_line(error: Exception) -> str:
    return " ".join(str(error).split())


def image_settings(command: str, **settings: object) -> str:
    """JSON text for the comment of an image: the command, the version of lumitree, and settings.

    Args:
        command: what made the image, such as "render".
        settings: values by name, as for `plain`; values that are None are omitted.
    """
    given = {name: plain(value) for name, value in settings.items() if value is not None}
    return json.dumps({"lumitree": __version__, "command": command, **given}, ensure_ascii=False)
