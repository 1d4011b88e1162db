"""The files that an OBJ model names: one that is missing is left out, with a warning."""

import os
import posixpath
import warnings
from collections.abc import Callable, Hashable
from pathlib import Path

from numpy.typing import NDArray

from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeWarning, shown
from lumitree.lamp.importers.images import DecodedImage, Images
from lumitree.lamp.importers.model_folder import MAX_MODEL_BYTES, ModelFolder

_FORMATS = ("PNG", "JPEG", "TGA", "BMP", "TIFF", "WEBP")
# Bytes of a pixel of the largest array that is made of an image.
_PIXEL_BYTES = 12


class ObjFolder:
    """The folder of an OBJ file, and the images of its materials."""

    def __init__(self, model: Path) -> None:
        self._model = model
        self._folder = ModelFolder(model)
        self._images = Images()

    def find(self, name: str, purpose: str) -> Path | None:
        """Path of a file that the model names; None, after a warning, where there is none.

        `purpose` says what names it.
        """
        path = self._folder.find(name, f"{self._model}: {purpose}")
        if path is None:
            warnings.warn(
                f"{self._model}: {purpose} names {shown(name)!r}, which is not there; it is "
                "ignored",
                LumitreeWarning,
                stacklevel=3,
            )
        return path

    def name_beside(self, path: Path, name: str) -> str:
        """The name, in the model's folder, of a file that another names if it is relative to that.

        The name as it is if there is no such file.
        """
        below = os.path.relpath(os.path.realpath(path.parent), os.path.realpath(self._model.parent))
        beside = posixpath.normpath(f"{Path(below).as_posix()}/{name}".replace("\\", "/"))
        return beside if os.path.isfile(self._model.parent / beside) else name

    def image(self, name: str, purpose: str) -> DecodedImage | None:
        """An image that the model names; None, after a warning, where there is none."""
        path = self.find(name, purpose)
        if path is None:
            return None

        def read() -> bytes:
            return read_bytes(path, "an image", MAX_MODEL_BYTES)

        return self._images.decoded(name, read, shown(path, 300), _FORMATS)

    def made(
        self,
        name: str,
        role: Hashable,
        image: DecodedImage,
        make: Callable[[DecodedImage], NDArray],
    ) -> NDArray:
        """Result of `make` for the image called `name`, once for each role."""
        height, width = image.pixels.shape[:2]
        size = _PIXEL_BYTES * height * width
        return self._images.made((name, role), size, shown(name), lambda: make(image))
