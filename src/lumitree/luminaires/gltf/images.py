"""Images of a glTF file, decoded within limits."""

import dataclasses
import io
import warnings
from typing import Literal

import numpy as np
from numpy.typing import NDArray
from PIL import Image

from lumitree.luminaires.gltf.container import Document
from lumitree.luminaires.gltf.item import Item

MAX_IMAGE_PIXELS = 8192 * 8192
MAX_TOTAL_PIXELS = 2**28
_FORMATS = ("PNG", "JPEG", "WEBP")
_NEAREST = 9728
_WRAPS: dict[int, Literal["repeat", "mirror", "clamp"]] = {
    10497: "repeat",
    33648: "mirror",
    33071: "clamp",
}


@dataclasses.dataclass(frozen=True)
class Sampler:
    """How an image is looked up.

    Attributes:
        wrap: what lies outside [0, 1] along u, and along v.
        nearest: no interpolation between pixels.
    """

    wrap: tuple[Literal["repeat", "mirror", "clamp"], Literal["repeat", "mirror", "clamp"]]
    nearest: bool


class Images:
    """Decodes images, each once."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._decoded: dict[int, NDArray[np.uint8]] = {}
        self._pixels = 0

    def texture(self, index: int) -> tuple[NDArray[np.uint8], Sampler]:
        """Pixels [H, W, 4] of a texture, and how they are looked up.

        Raises:
            LumitreeError: missing, outside the model's folder, damaged, or too large.
        """
        texture = self._document.entry("textures", index)
        source = texture.index("source")
        if source is None and (webp := texture.extension("EXT_texture_webp")) is not None:
            source = webp.index("source")
        if source is None:
            raise texture.error("has no PNG, JPEG or WebP image; export it with one")
        if source not in self._decoded:
            self._decoded[source] = self._decode(self._document.entry("images", source))
        return self._decoded[source], self._sampler(texture)

    def _sampler(self, texture: Item) -> Sampler:
        index = texture.index("sampler")
        if index is None:
            return Sampler(("repeat", "repeat"), False)
        item = self._document.entry("samplers", index)
        along_u, along_v = item.integer("wrapS", 10497), item.integer("wrapT", 10497)
        if along_u not in _WRAPS or along_v not in _WRAPS:
            raise item.error(f"has wrap modes {along_u} and {along_v}; expected {sorted(_WRAPS)}")
        nearest = item.integer("magFilter", 9729) == _NEAREST
        return Sampler((_WRAPS[along_u], _WRAPS[along_v]), nearest)

    def _decode(self, item: Item) -> NDArray[np.uint8]:
        view = item.index("bufferView")
        data = self._document.resource(item) if view is None else self._document.view(view)[0]
        try:
            with warnings.catch_warnings():
                # Pillow's own limits warn first; here the size is judged below.
                warnings.simplefilter("ignore", Image.DecompressionBombWarning)
                image = Image.open(io.BytesIO(data), formats=_FORMATS)
            # The header is all that has been read so far.
            self._allow(image.width * image.height, item)
            return _rgba(image)
        except Image.DecompressionBombError:
            raise item.error(f"has more than {MAX_IMAGE_PIXELS} pixels") from None
        except (OSError, SyntaxError, ValueError, EOFError, IndexError, KeyError) as error:
            reason = " ".join(str(error).split())[:80]
            raise item.error(f"is no PNG, JPEG or WebP image that can be read: {reason}") from error

    def _allow(self, pixels: int, item: Item) -> None:
        self._pixels += pixels
        if pixels > MAX_IMAGE_PIXELS:
            raise item.error(f"has {pixels} pixels; at most {MAX_IMAGE_PIXELS} are read")
        if self._pixels > MAX_TOTAL_PIXELS:
            raise item.error(
                f"brings the model to {self._pixels} pixels; at most {MAX_TOTAL_PIXELS} are read"
            )


def _rgba(image: Image.Image) -> NDArray[np.uint8]:
    if image.mode.startswith("I"):
        # 16-bit grey; Pillow's own conversion would clip it at 255.
        grey = (np.asarray(image).astype(np.int64) * 255 + 32767) // 65535
        return np.stack([*[grey] * 3, np.full_like(grey, 255)], axis=-1).astype(np.uint8)
    if image.mode == "CMYK":
        image = image.convert("RGB")
    return np.asarray(image.convert("RGBA"))
