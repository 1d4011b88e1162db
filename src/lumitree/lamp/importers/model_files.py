"""The files and images that a model names: only in its own folder, and of limited size."""

import contextlib
import contextvars
import dataclasses
import hashlib
import io
import os
import re
import unicodedata
import warnings
from collections.abc import Callable, Hashable, Iterator
from pathlib import Path
from urllib.parse import unquote

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from lumitree.asset.materials import Image as PixelArray
from lumitree.core.images import MAX_SIDE
from lumitree.errors import LumitreeError, LumitreeWarning, shown

# Largest size of a scene, of a model file and of an image that it names.
MAX_MODEL_BYTES = 512 * 2**20
# Last components of a path that are looked for in the model's folder.
_MAX_COMPONENTS = 32

# Files that models have named in the innermost block of `noted_files`.
_noted: contextvars.ContextVar[set[Path] | None] = contextvars.ContextVar("noted", default=None)
MAX_IMAGE_PIXELS = 8192 * 8192
# Largest size of everything that is decoded and computed for one model; four images of 4096²
# pixels, used in every role, need less.
MAX_TOTAL_BYTES = 5 * 2**28
# Each scan of a progressive JPEG file, of which a few bytes are enough, takes the time of a whole
# image. Programs write about ten.
_MAX_SCANS = 100
# Markers that a length follows, and the end of the image.
_JPEG_MARKER = re.compile(rb"\xff([^\x00\x01\xd0-\xd8\xff])")
_BLOCK_PIXELS = 2**20


@contextlib.contextmanager
def noted_files() -> Iterator[set[Path]]:
    """Context that notes the files that models name in it, also those that are missing."""
    files: set[Path] = set()
    token = _noted.set(files)
    try:
        yield files
    finally:
        _noted.reset(token)


class ModelFolder:
    """The folder of a model file: nothing outside it is read.

    A name is a path relative to the folder. A name with another path (absolute, of Windows, a URL,
    or with ..) often remains from the machine on which the model was made. Then the file of the
    same name in the folder is taken: that for which most of the path's last components agree.
    Lower and upper case are not distinguished if no file has the exact name.
    """

    def __init__(self, model: str | os.PathLike[str]) -> None:
        self._folder = Path(os.path.realpath(Path(model).parent))
        self._listings: dict[Path, dict[str, str]] = {}
        # Warned of once.
        self._substituted: set[str] = set()

    def find(self, name: str, where: str) -> Path | None:
        """Path of a file that the model names; None where there is none.

        A file with another path or in another case is taken with a warning.

        Args:
            name: with / or \\ between components.
            where: what names it, for messages.

        Raises:
            LumitreeError: the file is a link that leads out of the folder.
        """
        components, relative = _components(name)
        path = self._folder.joinpath(*components) if relative else None
        exact = path is not None and os.path.isfile(path)
        named = path
        path = path if exact else self._similar(components)
        if (files := _noted.get()) is not None:
            files |= {each for each in (named, path) if each is not None}
        if path is None:
            return None
        if not Path(os.path.realpath(path)).is_relative_to(self._folder):
            raise LumitreeError(
                f"{where} names {shown(name)!r}, a link out of the model's folder; put the file "
                "itself there"
            )
        if not exact and name not in self._substituted:
            self._substituted.add(name)
            found = shown(path.relative_to(self._folder).as_posix())
            warnings.warn(
                f"{where} names {shown(name)!r}; {found!r} in the model's folder is taken",
                LumitreeWarning,
                stacklevel=3,
            )
        return path

    def _similar(self, components: list[str]) -> Path | None:
        """The file that agrees with most of the last components, in any case."""
        components = components[-_MAX_COMPONENTS:]
        for first in range(len(components)):
            path = self._folder
            for component in components[first:]:
                found = self._listing(path).get(_folded(component))
                if found is None:
                    break
                path = path / found
            else:
                if os.path.isfile(path):
                    return path
        return None

    def _listing(self, folder: Path) -> dict[str, str]:
        """Names in a folder by the same without case; of several the first in order.

        Links out of the model's folder are not followed.
        """
        if folder not in self._listings:
            inside = Path(os.path.realpath(folder)).is_relative_to(self._folder)
            try:
                names = sorted(os.listdir(folder), reverse=True) if inside else []
            except OSError:
                names = []
            self._listings[folder] = {_folded(name): name for name in names}
        return self._listings[folder]


def _components(name: str) -> tuple[list[str], bool]:
    """Components of a path, and whether it is relative to the model's folder and below it."""
    if "\0" in name:
        return [], False
    scheme = re.match(r"[A-Za-z][A-Za-z0-9+.-]*:", name)
    if scheme is not None:
        name = name[scheme.end() :]
        # A single letter is a drive.
        if scheme.end() > 2:
            name = unquote(name)
    parts = name.replace("\\", "/").split("/")
    relative = scheme is None and parts[0] != "" and ".." not in parts
    if ".." in parts:
        parts = parts[len(parts) - parts[::-1].index("..") :]
    return [part for part in parts if part not in ("", ".")], relative


def _folded(name: str) -> str:
    return unicodedata.normalize("NFC", name).casefold()


@dataclasses.dataclass(frozen=True, eq=False)
class DecodedImage:
    """R, G, B and opacity [H, W, 4] as a file encodes them; how many pixels have each value."""

    pixels: NDArray[np.uint8]
    counts: NDArray[np.int64]


class Images:
    """The images of one model: each is decoded once, and each array of them made once.

    Attributes:
        pixels: the images of the model's textures; equal ones are one.
    """

    def __init__(self) -> None:
        self.pixels: list[PixelArray] = []
        self._decoded: dict[Hashable, DecodedImage] = {}
        self._made: dict[Hashable, int] = {}
        self._known: dict[tuple[object, ...], int] = {}
        self._bytes = 0

    def decoded(
        self, key: Hashable, read: Callable[[], bytes], where: str, formats: tuple[str, ...]
    ) -> DecodedImage:
        """The image of a key within the model; `read` returns the bytes of its file if needed.

        `where` says what the image is; `formats` are tried, by Pillow's names.
        """
        if key not in self._decoded:
            self._decoded[key] = self._decode(read(), where, formats)
        return self._decoded[key]

    def made(self, key: Hashable, size: int, where: str, make: Callable[[], PixelArray]) -> int:
        """Index of the array of a key, computed on first use; other arguments as for `spend`."""
        if key not in self._made:
            self.spend(size, where)
            self._made[key] = self.add(make())
        return self._made[key]

    def add(self, pixels: PixelArray) -> int:
        """Index of an array [H, W, C] among `pixels`."""
        digest = hashlib.sha256(np.ascontiguousarray(pixels).data).digest()
        key = pixels.shape, pixels.dtype.name, digest
        if key not in self._known:
            self._known[key] = len(self.pixels)
            self.pixels.append(pixels)
        return self._known[key]

    def spend(self, size: int, where: str) -> None:
        """Count bytes that are about to be held or computed; too many for one model are refused."""
        self._bytes += size
        if self._bytes > MAX_TOTAL_BYTES:
            raise LumitreeError(
                f"{where} brings the model's images and what is computed from them to "
                f"{self._bytes // 2**20} MiB; at most {MAX_TOTAL_BYTES // 2**20} MiB: make the "
                "images smaller"
            )

    def _decode(self, data: bytes, where: str, formats: tuple[str, ...]) -> DecodedImage:
        try:
            with warnings.catch_warnings():
                # Pillow warns of images that are large or unusual; the size is checked below.
                warnings.simplefilter("ignore")
                image = Image.open(io.BytesIO(data), formats=formats)
                # Only the header has been read so far.
                _check_size(image, where)
                if image.format == "JPEG" and _scans(data) > _MAX_SCANS:
                    raise LumitreeError(
                        f"{where} has more than {_MAX_SCANS} scans; save it as a PNG file"
                    )
                self.spend(4 * image.width * image.height, where)
                image = _rgba(image)
        except Image.DecompressionBombError:
            raise LumitreeError(f"{where} has too many pixels; make it smaller") from None
        except LumitreeError:
            raise
        except Exception as error:
            # Pillow's decoders raise exceptions of many types for damaged files.
            reason = shown(" ".join(str(error).split()) or type(error).__name__)
            if isinstance(error, UnidentifiedImageError):
                # Its message has the address of an object.
                reason = "it is in none of these formats, or its header is damaged"
            raise LumitreeError(
                f"{where} is not a readable image ({', '.join(formats)}): {reason}"
            ) from None
        counts = np.array(image.histogram(), np.int64).reshape(4, 256)
        return DecodedImage(np.asarray(image), counts)


def num_pixels(data: bytes) -> int:
    """Number of pixels that the header of an image states; 0 for other files."""
    try:
        with warnings.catch_warnings(action="ignore"), Image.open(io.BytesIO(data)) as image:
            return image.width * image.height
    except Image.DecompressionBombError:
        return MAX_IMAGE_PIXELS
    except Exception:
        # The decoder says what is wrong with it.
        return 0


def by_rows(
    make: Callable[[slice], NDArray], shape: tuple[int, int, int], dtype: np.dtype | type
) -> NDArray:
    """An array [H, W, C], computed block by block to bound the memory of intermediate results.

    `make` returns the rows of a slice.
    """
    result = np.empty(shape, dtype)
    step = max(1, _BLOCK_PIXELS // shape[1])
    for start in range(0, shape[0], step):
        rows = slice(start, min(start + step, shape[0]))
        result[rows] = make(rows)
    return result


def looked_up(levels: NDArray, pixels: NDArray[np.uint8]) -> NDArray:
    """Values [H, W, C] of a table [256, C] at the indices `pixels` [H, W, C]."""
    planes = [levels[:, at][pixels[..., at]] for at in range(pixels.shape[2])]
    return np.stack(planes, axis=-1)


def _check_size(image: Image.Image, where: str) -> None:
    sides = (image.width, image.height)
    if max(sides) > MAX_SIDE or sides[0] * sides[1] > MAX_IMAGE_PIXELS:
        raise LumitreeError(
            f"{where} has {sides[0]} x {sides[1]} pixels; at most {MAX_SIDE} along a side and "
            f"{MAX_IMAGE_PIXELS} in an image: make it smaller"
        )


def _scans(data: bytes) -> int:
    """Number of scans of a JPEG file."""
    at = count = 0
    while (found := _JPEG_MARKER.search(data, at)) and found[1] != b"\xd9":
        count += found[1] == b"\xda"
        at = found.end() + int.from_bytes(data[found.end() : found.end() + 2], "big")
    return count


def _rgba(image: Image.Image) -> Image.Image:
    if image.mode.startswith("I"):
        # 16-bit grey; Pillow's own conversion would clip it at 255.
        grey = np.asarray(image).clip(0, 65535).astype(np.uint32)
        image = Image.fromarray(((grey * 255 + 32767) // 65535).astype(np.uint8))
    elif image.mode == "CMYK":
        image = image.convert("RGB")
    return image.convert("RGBA")
