"""The files that a model names, never outside its own folder, never larger than is sensible."""

import os
import re
import warnings
from pathlib import Path

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lumitree.errors import LumitreeError, LumitreeWarning

MAX_MODEL_BYTES = 512 * 2**20
MAX_IMAGE_PIXELS = 8192 * 8192
MAX_TOTAL_PIXELS = 4 * MAX_IMAGE_PIXELS
_IMAGE_FORMATS = ("PNG", "JPEG", "TGA", "BMP", "TIFF", "WEBP")


def read_limited(path: Path, limit: int = MAX_MODEL_BYTES) -> bytes:
    """Bytes of a regular file.

    Raises:
        LumitreeError: there is none, it cannot be read, or it is larger than `limit` bytes.
    """
    if not path.is_file():
        raise LumitreeError(f"{path} does not exist or is not a file")
    try:
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except OSError as error:
        raise LumitreeError(f"{path} cannot be read: {error.strerror or error}") from None
    if len(data) > limit:
        raise LumitreeError(f"{path} is larger than {limit // 2**20} MiB; make it smaller")
    return data


class ModelFolder:
    """The folder of a model file: files beside it, images decoded once."""

    def __init__(self, model: str | os.PathLike[str]) -> None:
        self._model = Path(model)
        self._images: dict[Path, NDArray[np.uint8]] = {}
        self._pixels = 0

    def find(self, name: str, purpose: str) -> Path | None:
        """Path of a file that the model names; None, after a warning, where there is none.

        Args:
            name: relative to the model's folder, with / or \\.
            purpose: what names it, for messages.

        Raises:
            LumitreeError: the name leads out of the folder.
        """
        parts = name.replace("\\", "/").split("/")
        if (
            not name
            or "\0" in name
            or parts[0] == ""
            or ".." in parts
            or re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name)
        ):
            raise LumitreeError(
                f"{self._model}: {purpose} names {name!r}; expected a file in the model's own "
                "folder: copy it there and name it without a path"
            )
        folder = self._model.parent.resolve()
        path = folder.joinpath(*parts)
        try:
            inside = path.resolve().is_relative_to(folder)
            found = path.is_file()
        except (OSError, RuntimeError):
            inside, found = True, False
        if not inside:
            raise LumitreeError(
                f"{self._model}: {purpose} names {name!r}, a link out of the model's folder; "
                "put the file itself there"
            )
        if not found:
            warnings.warn(
                f"{self._model}: {purpose} names {name!r}, which is not there; going on without it",
                LumitreeWarning,
                stacklevel=3,
            )
            return None
        return path

    def image(self, path: Path) -> NDArray[np.uint8]:
        """Pixels [H, W, 4] (R, G, B, opacity) of an image, as its file encodes them.

        Raises:
            LumitreeError: it is damaged, of an unknown format, or too large.
        """
        if path not in self._images:
            self._images[path] = self._decoded(path)
        return self._images[path]

    def _decoded(self, path: Path) -> NDArray[np.uint8]:
        try:
            # Pillow warns of, or refuses, what is larger than its own limit as soon as it opens.
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")
                opened = Image.open(path, formats=_IMAGE_FORMATS)
        except Image.DecompressionBombError:
            raise LumitreeError(f"{path} has too many pixels; make it smaller") from None
        except (OSError, ValueError, SyntaxError) as error:
            raise LumitreeError(f"{path} is not a readable image: {_one_line(error)}") from None
        with opened as image:
            pixels = image.width * image.height
            self._pixels += pixels
            if pixels > MAX_IMAGE_PIXELS or self._pixels > MAX_TOTAL_PIXELS:
                raise LumitreeError(
                    f"{path} has {image.width} x {image.height} pixels; at most "
                    f"{MAX_IMAGE_PIXELS} in an image and {MAX_TOTAL_PIXELS} in all of a lamp's"
                )
            try:
                return np.asarray(_eight_bits(image).convert("RGBA"))
            except (OSError, ValueError, SyntaxError, MemoryError) as error:
                raise LumitreeError(f"{path} is a damaged image: {_one_line(error)}") from None


def _eight_bits(image: Image.Image) -> Image.Image:
    if image.mode.startswith("I"):
        return Image.fromarray((np.asarray(image) >> 8).clip(0, 255).astype(np.uint8))
    return image


def _one_line(error: BaseException) -> str:
    return " ".join(str(error).split()) or type(error).__name__
