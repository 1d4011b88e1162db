"""The parameters of glTF materials as maps (factors times textures), and arithmetic with them.

A map has linear values, so that factors, products and conversions are the same for a constant
and for an image; only the finished map is converted to a `Texture` or a number. An image is stored
as 8-bit codes with a table of the codes' values. A function of each value alone is applied to the
table; only functions of several channels or maps make arrays of floats.
"""

import dataclasses
from collections.abc import Callable, Iterator
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.materials import Texture
from lumitree.core.frames import rows_of
from lumitree.core.images import linear_from_srgb, resized, srgb_from_linear
from lumitree.core.photometry import RGB
from lumitree.errors import shown
from lumitree.lamp.importers.gltf_document import Document, Item, Notes
from lumitree.lamp.importers.model_files import DecodedImage, Images, by_rows, looked_up
from lumitree.lamp.meshes import Floats

_FORMATS = ("PNG", "JPEG", "WEBP")
_NEAREST = 9728
Wrap = Literal["repeat", "mirror", "clamp"]
_WRAPS: dict[int, Wrap] = {10497: "repeat", 33648: "mirror", 33071: "clamp"}
Array = NDArray[np.floating]
_FLOAT_BYTES = 4
_LINEAR = (np.arange(256) / 255).astype(np.float32)
_DECODED = linear_from_srgb(np.arange(256) / 255).astype(np.float32)


@dataclasses.dataclass(frozen=True)
class Sampler:
    """How an image is looked up; `wrap` is outside [0, 1], along u and along v."""

    wrap: tuple[Wrap, Wrap] = ("repeat", "repeat")
    nearest: bool = False


@dataclasses.dataclass(frozen=True, eq=False)
class Map:
    """Values over a surface.

    Attributes:
        levels: [256, C] values of an image's codes, or [1, C] of a constant, linear; unused
            where there are `floats`.
        image: whose codes they are; None for a constant, and where there are `floats`.
        first: channel of the image that is the map's first.
        floats: [H, W, C] computed values; None for a constant and for an image.
        sampler: how the image is looked up; None for a constant.
        uv_transform: [4, 4] from the mesh's texture coordinates to the image's.
        where: what the map is of, for messages.
    """

    levels: Array
    image: DecodedImage | None = None
    first: int = 0
    floats: Array | None = None
    sampler: Sampler | None = None
    uv_transform: Floats = dataclasses.field(default_factory=lambda: np.eye(4))
    where: str = ""

    @property
    def constant(self) -> bool:
        return self.sampler is None

    @property
    def shape(self) -> tuple[int, int, int]:
        """(H, W, C); a constant has one pixel."""
        if self.floats is not None:
            height, width, channels = self.floats.shape
            return height, width, channels
        height, width = (1, 1) if self.image is None else self.image.pixels.shape[:2]
        return height, width, self.levels.shape[1]

    def values(self, rows: slice = slice(None)) -> Array:
        """[H, W, C] of some of the rows."""
        if self.floats is not None:
            return self.floats[rows]
        if self.image is None:
            return self.levels[None]
        return looked_up(self.levels, self.codes[rows])

    @property
    def codes(self) -> NDArray[np.uint8]:
        """[H, W, C] of the image."""
        assert self.image is not None
        return self.image.pixels[..., self.first : self.first + self.levels.shape[1]]

    def channel(self, index: int) -> "Map":
        """One channel."""
        one = slice(index, index + 1)
        floats = None if self.floats is None else self.floats[..., one]
        return dataclasses.replace(
            self, levels=self.levels[:, one], first=self.first + index, floats=floats
        )

    def applied(self, function: Callable[[Array], Array]) -> "Map":
        """A function of each value alone, given arrays [..., C]."""
        if self.floats is not None:
            return dataclasses.replace(self, floats=function(self.floats))
        return dataclasses.replace(self, levels=function(self.levels))

    def scaled(self, *factor: float) -> "Map":
        """Times a factor for all channels, or for each."""
        if all(entry == 1 for entry in factor):
            return self
        return self.applied(lambda values: (values * np.array(factor)).astype(values.dtype))

    def mean(self) -> tuple[float, ...]:
        """[C] of the constant, or mean of the image."""
        if self.floats is not None:
            return tuple(self.floats.mean(axis=(0, 1), dtype=np.float64).tolist())
        weights = self._counts()
        return tuple(((weights * self.levels).sum(axis=0) / weights.sum(axis=0)).tolist())

    def black(self) -> bool:
        return (flat := self.flat()) is not None and not any(flat)

    def flat(self) -> tuple[float, ...] | None:
        """[C] where it is the same everywhere; None where it is not."""
        if self.floats is not None:
            if (self.floats != self.floats[:1, :1]).any():
                return None
            return tuple(self.floats[0, 0].astype(np.float64).tolist())
        used = self._counts() > 0
        found = [self.levels[used[:, at], at] for at in range(self.levels.shape[1])]
        if any((values != values[0]).any() for values in found):
            return None
        return tuple(float(values[0]) for values in found)

    def same_place(self, other: "Map") -> bool:
        """Whether both are looked up at the same point of their images."""
        return self.sampler == other.sampler and np.allclose(self.uv_transform, other.uv_transform)

    def _counts(self) -> NDArray[np.int64]:
        if self.image is None:
            return np.ones(self.levels.shape, np.int64)
        return self.image.counts[self.first : self.first + self.levels.shape[1]].T


def constant(*values: float) -> Map:
    """A map that is the same everywhere."""
    return Map(np.array(values, np.float64)[None])


class Textures:
    """Reads a file's textures as maps, and turns maps into the model's textures."""

    def __init__(self, document: Document) -> None:
        self._document, self.images = document, Images()

    def read(self, info: Item, channels: str, encoded: bool) -> Map | str:
        """Map [H, W, C] of a texture info; the name of its image's file if that is missing.

        `channels` are neighbours in "RGBA", such as "RGB" or "A"; `encoded` values are in sRGB.
        """
        texture = self._document.entry("textures", info.integer("index"))
        source = texture.index("source")
        if source is None and (webp := texture.extension("EXT_texture_webp")) is not None:
            source = webp.index("source")
        if source is None:
            raise texture.error("has no PNG, JPEG or WebP image; export it with one")
        item = self._document.entry("images", source)
        if self._document.is_missing(item):
            return item.string("uri", "")
        image = self.images.decoded(source, lambda: self._bytes(item), item.where, _FORMATS)
        levels = np.repeat((_DECODED if encoded else _LINEAR)[:, None], len(channels), axis=1)
        first, sampler = "RGBA".index(channels), self._sampler(texture)
        return Map(levels, image, first, None, sampler, uv_transform(info), info.where)

    def _sampler(self, texture: Item) -> Sampler:
        index = texture.index("sampler")
        if index is None:
            return Sampler()
        item = self._document.entry("samplers", index)
        along_u, along_v = item.integer("wrapS", 10497), item.integer("wrapT", 10497)
        if along_u not in _WRAPS or along_v not in _WRAPS:
            raise item.error(f"has wrap modes {along_u} and {along_v}; expected {sorted(_WRAPS)}")
        nearest = item.integer("magFilter", 9729) == _NEAREST
        return Sampler((_WRAPS[along_u], _WRAPS[along_v]), nearest)

    def _bytes(self, item: Item) -> bytes:
        view = item.index("bufferView")
        return (
            self._document.resource(item) if view is None else bytes(self._document.view(view)[0])
        )

    def combined(self, function: Callable[..., Array], *maps: Map) -> tuple[Map, bool]:
        """A function of several maps [H, W, C], point by point, and whether the result is exact.

        Smaller images are enlarged. A texture that is placed differently from the first one enters
        with its mean.
        """
        lead = next((entry for entry in maps if not entry.constant), maps[0])
        if all(entry.constant for entry in maps):
            return Map(function(*(entry.values() for entry in maps))[0]), True
        placed = [
            entry if entry.constant or entry.same_place(lead) else constant(*entry.mean())
            for entry in maps
        ]
        exact = all(new is old for new, old in zip(placed, maps, strict=True))
        height = max(entry.shape[0] for entry in placed)
        width = max(entry.shape[1] for entry in placed)
        placed = [self._resized(entry, height, width) for entry in placed]

        def rows_of(rows: slice) -> Array:
            blocks = (entry.values(slice(None) if entry.constant else rows) for entry in placed)
            return function(*blocks)

        channels = rows_of(slice(0, 1)).shape[2]
        self.images.spend(_FLOAT_BYTES * height * width * channels, lead.where)
        floats = by_rows(rows_of, (height, width, channels), np.float32)
        return dataclasses.replace(lead, image=None, floats=floats), exact

    def _resized(self, source: Map, height: int, width: int) -> Map:
        if source.constant or source.shape[:2] == (height, width):
            return source
        channels = source.shape[2]
        self.images.spend(_FLOAT_BYTES * height * width * channels, source.where)
        floats = resized(source.values(), height, width)
        return dataclasses.replace(source, image=None, floats=floats)

    def colour(self, source: Map) -> RGB | Texture:
        """R, G and B in [0, 1]."""
        return _flat_rgb(source) or self._texture(
            source, lambda values: _bytes(srgb_from_linear(values)), np.uint8, encoded=True
        )

    def radiance(self, source: Map) -> RGB | Texture:
        """R, G and B, at least 0 and without an upper limit."""
        return _flat_rgb(source) or self._texture(source, lambda values: values, np.float32)

    def value(self, source: Map) -> float | Texture:
        """One channel of linear data."""
        flat = source.flat()
        return flat[0] if flat is not None else self.data(source)

    def data(self, source: Map) -> Texture:
        """Linear data, as a texture even where they are constant."""
        return self._texture(source, _bytes, np.uint8)

    def _texture(
        self,
        source: Map,
        convert: Callable[[Array], NDArray],
        dtype: type[np.uint8] | type[np.float32],
        encoded: bool = False,
    ) -> Texture:
        """Texture of a function of each value alone."""
        size = int(np.prod(source.shape)) * np.dtype(dtype).itemsize
        if source.image is None:
            self.images.spend(size, source.where)
            pixels = by_rows(lambda rows: convert(source.values(rows)), source.shape, dtype)
            image = self.images.add(pixels)
        else:
            table = convert(source.levels).astype(dtype)
            key = (id(source.image), source.first, np.dtype(dtype).name, table.tobytes())
            image = self.images.made(
                key, size, source.where, lambda: looked_up(table, source.codes)
            )
        sampler = source.sampler or Sampler()
        return Texture(
            image=image,
            raw=not encoded,
            filter_type="nearest" if sampler.nearest else "bilinear",
            wrap_mode=sampler.wrap[0],
            to_uv=rows_of(source.uv_transform),
        )


def _flat_rgb(source: Map) -> RGB | None:
    flat = source.flat()
    return None if flat is None else (flat[0], flat[1], flat[2])


def uv_transform(info: Item) -> Floats:
    """[4, 4] map of KHR_texture_transform: scale, then rotation, then offset.

    The rotation is counter-clockwise as one looks at the image, whose v axis points down: the
    readme's GLSL says the opposite, its first example and every viewer say this.
    """
    extension = info.extension("KHR_texture_transform")
    matrix = np.eye(4)
    if extension is None:
        return matrix
    angle = extension.number("rotation", 0.0)
    cos, sin = np.cos(angle), np.sin(angle)
    matrix[:2, :2] = np.array([[cos, sin], [-sin, cos]]) * extension.numbers("scale", (1.0, 1.0))
    matrix[:2, 3] = extension.numbers("offset", (0.0, 0.0))
    return matrix


def uv_set(info: Item) -> int:
    """Number of the texture coordinates that a texture info uses."""
    number = info.integer("texCoord", 0)
    extension = info.extension("KHR_texture_transform")
    return number if extension is None else extension.integer("texCoord", number)


def _bytes(values: Array) -> NDArray[np.uint8]:
    return np.round(np.clip(values, 0, 1) * 255).astype(np.uint8)


class Layers:
    """Reads the maps of one material.

    Attributes:
        item: the material's JSON.
        name: of the material, in the file.
        uv_set: number of the texture coordinates that all its textures are read with.
        textured: whether it has any texture.
    """

    def __init__(self, item: Item, name: str, textures: Textures, notes: Notes) -> None:
        self.item, self.name = item, name
        self._textures, self._notes = textures, notes
        sets = [uv_set(info) for info in _texture_infos(item)]
        self.uv_set = sets[0] if sets else 0
        self.textured = bool(sets)

    def note(self, text: str) -> None:
        """Note a property of the material that is approximated."""
        self._notes.material(self.name, text)

    def texture(self, parent: Item, key: str, channels: str, encoded: bool = False) -> Map | None:
        """A texture's channels; None where there is no such texture, or its image is missing."""
        if key not in parent:
            return None
        info = parent.item(key)
        if uv_set(info) != self.uv_set:
            self.note("textures with several sets of texture coordinates (one is used)")
        found = self._textures.read(info, channels, encoded)
        if isinstance(found, str):
            self.note(f"{key} (left out: {shown(found)!r} is not in the model's folder)")
            return None
        if found.sampler is not None and found.sampler.wrap[0] != found.sampler.wrap[1]:
            self.note("different wrapping along u and v")
        return found

    def colour(self, parent: Item, name: str, default: tuple[float, ...], high: float = 1.0) -> Map:
        """R, G and B of `nameFactor`, which is in [0, high], times the encoded `nameTexture`."""
        values = parent.numbers(f"{name}Factor", default, 0.0, high)[:3]
        texture = self.texture(parent, f"{name}Texture", "RGB", encoded=True)
        return constant(*values) if texture is None else texture.scaled(*values)

    def value(
        self, parent: Item, name: str, default: float, channel: str, texture: str = ""
    ) -> Map:
        """`nameFactor`, in [0, 1], times one channel of the linear `nameTexture`, or `texture`."""
        factor = parent.number(f"{name}Factor", default, 0.0, 1.0)
        found = self.texture(parent, texture or f"{name}Texture", channel)
        return constant(factor) if found is None else found.scaled(factor)

    def combined(self, function: Callable[..., Array], *maps: Map) -> Map:
        """A function of several channels or maps, point by point."""
        result, exact = self._textures.combined(function, *maps)
        if not exact:
            self.note("textures that are placed differently (the mean of one is used)")
        return result

    def single(self, source: Map, what: str) -> tuple[float, ...]:
        """The value of a map that has to be the same everywhere; the mean of a texture."""
        if not source.constant:
            self.note(f"{what} (its mean is used)")
        return source.mean()


def _texture_infos(material: Item) -> Iterator[Item]:
    """Every texture of a material, the base colour's first."""
    if (other := material.extension("KHR_materials_pbrSpecularGlossiness")) is not None:
        yield from _infos(other)
    yield from _infos(material.item("pbrMetallicRoughness"))
    # Occlusion textures are not used: light transport computes occlusion itself.
    yield from (info for info in _infos(material) if not info.where.endswith("occlusionTexture"))
    extensions = material.item("extensions")
    for name in extensions.data:
        yield from _infos(extensions.item(name))


def _infos(parent: Item) -> Iterator[Item]:
    first = ("baseColorTexture", "diffuseTexture")
    keys = [key for key in parent.data if key.endswith("Texture")]
    for key in sorted(keys, key=lambda key: key not in first):
        yield parent.item(key)
