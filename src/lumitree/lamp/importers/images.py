"""Images of a model, decoded within limits, and the arrays that are made of them."""

import dataclasses
import io
import re
import warnings
from collections.abc import Callable, Hashable

import numpy as np
from numpy.typing import NDArray
from PIL import Image, UnidentifiedImageError

from lumitree.core.images import MAX_SIDE
from lumitree.errors import LumitreeError, shown

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


@dataclasses.dataclass(frozen=True, eq=False)
class DecodedImage:
    """R, G, B and opacity [H, W, 4] as a file encodes them; how many pixels have each value."""

    pixels: NDArray[np.uint8]
    counts: NDArray[np.int64]


class Images:
    """The images of one model: each is decoded once, and each array of them made once."""

    def __init__(self) -> None:
        self._decoded: dict[Hashable, DecodedImage] = {}
        self._made: dict[Hashable, NDArray] = {}
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

    def made(self, key: Hashable, size: int, where: str, make: Callable[[], NDArray]) -> NDArray:
        """The array of a key, computed on first use; the other arguments are as for `spend`."""
        if key not in self._made:
            self.spend(size, where)
            self._made[key] = make()
        return self._made[key]

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
