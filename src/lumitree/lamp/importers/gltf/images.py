"""Images of a glTF file, and their samplers."""

import dataclasses
from typing import Literal

from lumitree.lamp.importers.gltf.container import Document
from lumitree.lamp.importers.gltf.item import Item
from lumitree.lamp.importers.images import DecodedImage, Images

_FORMATS = ("PNG", "JPEG", "WEBP")
_NEAREST = 9728
_WRAPS: dict[int, Literal["repeat", "mirror", "clamp"]] = {
    10497: "repeat",
    33648: "mirror",
    33071: "clamp",
}


@dataclasses.dataclass(frozen=True)
class Sampler:
    """How an image is looked up; `wrap` is outside [0, 1], along u and along v."""

    wrap: tuple[Literal["repeat", "mirror", "clamp"], Literal["repeat", "mirror", "clamp"]]
    nearest: bool


class GltfImages:
    """The images of a glTF file's textures."""

    def __init__(self, document: Document, images: Images) -> None:
        self._document, self._images = document, images

    def texture(self, index: int) -> tuple[DecodedImage, Sampler] | str:
        """Image of a texture, and its sampler; the name of a file that is missing."""
        texture = self._document.entry("textures", index)
        source = texture.index("source")
        if source is None and (webp := texture.extension("EXT_texture_webp")) is not None:
            source = webp.index("source")
        if source is None:
            raise texture.error("has no PNG, JPEG or WebP image; export it with one")
        item = self._document.entry("images", source)
        if self._document.is_missing(item):
            return item.string("uri", "")
        image = self._images.decoded(source, lambda: self._bytes(item), item.where, _FORMATS)
        return image, self._sampler(texture)

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

    def _bytes(self, item: Item) -> bytes:
        view = item.index("bufferView")
        if view is None:
            return self._document.resource(item)
        return bytes(self._document.view(view)[0])
