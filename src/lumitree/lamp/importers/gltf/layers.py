"""The parameters of one glTF material as maps: factors times textures."""

from collections.abc import Callable, Iterator

from lumitree.errors import shown
from lumitree.lamp.importers.gltf.item import Item
from lumitree.lamp.importers.gltf.maps import Array, Map, Textures, constant, uv_set
from lumitree.lamp.importers.gltf.notes import Notes


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

    def value(self, parent: Item, name: str, default: float, channel: str, texture: str) -> Map:
        """`name`, in [0, 1], times one channel of the linear texture called `texture`."""
        factor = parent.number(name, default, 0.0, 1.0)
        found = self.texture(parent, texture, channel)
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
