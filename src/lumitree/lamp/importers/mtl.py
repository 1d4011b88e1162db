"""MTL files: their values and maps, and their conversion by the first of these rules that applies.

1. Glass where `illum` is 4, 6, 7 or 9, or `d` is below 1 while `Ni` is above 1: `Ni` is the index
   of refraction (1.5 if it is no more than 1) and `Tf` the transmittance of the whole object. Glass
   is solid where the mesh is closed, otherwise one thin sheet. `d` has no further effect.
2. Metallic-roughness where there is a physically based key (`Pr`, `Pm`, `Ps`, `Pc`, `Pcr` or
   `aniso`).
3. Metal where `illum` is 3 or 5 and `Ks` is at least as bright as `Kd`: it reflects `Ks`.
4. Metallic-roughness where `Ks` is not black and `illum` is not 0 or 1: `Kd`, with the roughness
   that corresponds to `Ns`.
5. Diffuse `Kd`.

In materials other than glass, `d` or 1 - `Tr` is the opacity. `Ke` is the emitted radiance,
W/(m² sr). Opaque materials reflect equally on both sides.

Vertex colours are a factor of `Kd`; `Ke` does not depend on them. They are not used by glass, metal
and materials with `map_Kd`. The physically based keys (Pr, Pm, Ps, Pc, Pcr, aniso, norm) are an
extension by Exocortex.
"""

import dataclasses
import math
import os
import posixpath
import warnings
from collections.abc import Callable, Hashable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.asset import materials as surfaces
from lumitree.asset.materials import Image, Texture, VertexColours, textures_of, transmits
from lumitree.core.file_kinds import in_utf8
from lumitree.core.images import linear_from_srgb
from lumitree.core.photometry import RGB
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.importers.model_files import (
    MAX_MODEL_BYTES,
    DecodedImage,
    Images,
    ModelFolder,
    by_rows,
    looked_up,
)
from lumitree.lamp.importers.obj_text import readable, with_point
from lumitree.lamp.importers.topology import count_solids
from lumitree.lamp.materials import WHITE, Material, Radiance, Value, glass, metal
from lumitree.lamp.meshes import Mesh

_MAX_BYTES = 16 * 2**20
# Keys with up to three numbers, spelled as below whatever case the file has.
_VALUES = ("Ka", "Kd", "Ks", "Ke", "Tf", "Ns", "Ni", "d", "Tr", "illum")
_VALUES += ("Pr", "Pm", "Ps", "Pc", "Pcr", "aniso", "anisor", "sharpness")
_NAMES = {key.lower(): key for key in _VALUES}
_COLOURS = ("Ka", "Kd", "Ks", "Ke", "Tf")
_MAPS = {"map_bump": "bump", "bump": "bump", "norm": "norm", "map_kn": "norm", "map_norm": "norm"}
_MAPS |= {"disp": "disp", "map_disp": "disp", "decal": "decal", "refl": "refl", "map_refl": "refl"}
_MAPS |= {"map_tr": "map_d", "map_opacity": "map_d"}
_MAX_VALUE = 1e9
# Numbers that an option takes at most, and those with which it changes nothing.
_NUM_VALUES = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2, "-bm": 1, "-boost": 1, "-texres": 1}
_NEUTRAL = {"-mm": [0.0, 1.0], "-t": [0.0, 0.0, 0.0], "-boost": [0.0]}
_FORMATS = ("PNG", "JPEG", "TGA", "BMP", "TIFF", "WEBP")
# Bytes of a pixel of the largest array that is made of an image.
_PIXEL_BYTES = 12
_GLASS_ILLUM, _MIRROR_ILLUM = (4, 6, 7, 9), (3, 5)
# Number of values (four a pixel) that are tested to find out whether an image is a normal map.
_NUM_PROBES = 2**22
_PHYSICAL = ("Pr", "Pm", "Ps", "Pc", "Pcr", "aniso")
_USED_MAPS = {"map_Kd", "map_Ke", "map_d", "map_Pr", "map_Pm", "map_Ps", "bump", "norm", "map_Ka"}
_BLACK: RGB = (0.0, 0.0, 0.0)
_GREY: RGB = (0.5, 0.5, 0.5)


@dataclasses.dataclass(frozen=True)
class MtlMap:
    """An image that a material names.

    `scale` and `offset` are of u and v, with v = 0 at the image's last row, as in the file. `clamp`
    limits texture coordinates to [0, 1]; `ignored` options have no effect here.
    """

    file: str
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False
    bump_scale: float = 1.0
    ignored: tuple[str, ...] = ()


@dataclasses.dataclass
class MtlMaterial:
    """A `newmtl` block: numbers by key, and maps by key."""

    values: dict[str, tuple[float, ...]] = dataclasses.field(default_factory=dict)
    maps: dict[str, MtlMap] = dataclasses.field(default_factory=dict)

    @property
    def emits(self) -> bool:
        return "map_Ke" in self.maps or max(self.values.get("Ke", (0.0,))) > 0


def parse_mtl(path: Path) -> dict[str, MtlMaterial]:
    """Materials of an MTL file of at most 16 MiB by name; the first of a name counts."""
    materials: dict[str, MtlMaterial] = {}
    current = MtlMaterial()
    lines = in_utf8(read_bytes(path, "an MTL file", _MAX_BYTES)).split(b"\n")
    for number, line in enumerate(lines, 1):
        words = readable(line.strip().replace(b"\t", b" ")).split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        key, rest = words[0].lower(), words[1].strip() if len(words) > 1 else ""
        where = f"{path}, line {number}"
        if key == "newmtl":
            current = MtlMaterial()
            materials.setdefault(rest, current)
        elif key in _NAMES:
            _add_value(current, _NAMES[key], rest, where)
        elif key.startswith("map_") or key in _MAPS:
            name = _MAPS.get(key) or "map_" + _NAMES.get(key[4:], key[4:])
            current.maps[name] = _map(rest, where)
    return materials


def _add_value(material: MtlMaterial, key: str, text: str, where: str) -> None:
    words = text.partition("#")[0].split()
    if words and words[0] in ("spectral", "xyz"):
        warnings.warn(
            f"{where}: {key} {words[0]} is not supported and not used; write R G B",
            LumitreeWarning,
            stacklevel=3,
        )
        return
    if key == "d" and words and words[0] == "-halo":
        words = words[1:]
    values = tuple(_number(word, key, where) for word in words[:3])
    if len(values) not in ((1, 3) if key in _COLOURS else (1, 2, 3)):
        raise LumitreeError(f"{where}: {key} has {len(values)} numbers; expected R G B or one")
    material.values[key] = values * 3 if key in _COLOURS and len(values) == 1 else values


def _number(word: str, key: str, where: str) -> float:
    try:
        value = float(with_point(word))
    except ValueError:
        value = math.nan
    if not abs(value) <= _MAX_VALUE:
        raise LumitreeError(f"{where}: {key} has {shown(word)!r}; expected a finite number")
    return value


def _map(text: str, where: str) -> MtlMap:
    """A map: options with their values, then the name of the image, which may contain spaces."""
    words, result, ignored = text.split(), {}, []
    while words and words[0].startswith("-"):
        option = words.pop(0).lower()
        # As many numbers as are there, up to the option's count.
        numbers: list[float] = []
        while words and len(numbers) < _NUM_VALUES.get(option, 0):
            try:
                float(with_point(words[0]))
            except ValueError:
                break
            numbers.append(_number(words.pop(0), option, where))
        if option in ("-s", "-o") and numbers:
            default = 1.0 if option == "-s" else 0.0
            result["scale" if option == "-s" else "offset"] = (*numbers, default)[:2]
        elif option == "-bm" and numbers:
            result["bump_scale"] = numbers[0]
        elif option == "-clamp" and words:
            result["clamp"] = words.pop(0).lower() == "on"
        elif option in ("-blendu", "-blendv", "-cc", "-imfchan", "-type") and words:
            word = words.pop(0).lower()
            if (option, word) not in (("-blendu", "on"), ("-blendv", "on"), ("-cc", "off")):
                ignored.append(f"{option} {word}")
        elif numbers != _NEUTRAL.get(option):
            ignored.append(option)
    if not words:
        raise LumitreeError(f"{where}: a map without the name of an image")
    # Cut from the text itself, which keeps runs of spaces inside a name.
    file = text.split(None, len(text.split()) - len(words))[-1]
    return MtlMap(file.strip().strip('"'), ignored=tuple(ignored), **result)


class ObjFolder:
    """The folder of an OBJ file, and the images of its materials.

    A file that is missing is ignored, with a warning.
    """

    def __init__(self, model: Path, images: Images) -> None:
        self._model, self.images = model, images
        self._folder = ModelFolder(model)

    def find(self, name: str, purpose: str) -> Path | None:
        """Path of a file that the model names; `purpose` says what names it."""
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
        """The name, in the model's folder, of a file beside another; else the name as it is."""
        below = os.path.relpath(os.path.realpath(path.parent), os.path.realpath(self._model.parent))
        beside = posixpath.normpath(f"{Path(below).as_posix()}/{name}".replace("\\", "/"))
        return beside if os.path.isfile(self._model.parent / beside) else name

    def image(self, name: str, purpose: str) -> DecodedImage | None:
        """An image that the model names."""
        path = self.find(name, purpose)
        if path is None:
            return None
        return self.images.decoded(
            path, lambda: read_bytes(path, "an image", MAX_MODEL_BYTES), shown(path, 300), _FORMATS
        )


def material(
    name: str, source: MtlMaterial | None, mesh: Mesh, folder: ObjFolder
) -> tuple[Material, RGB | None]:
    """The material of a mesh by its MTL block, and the factor of the vertex colours, if used.

    Without MTL block it is grey, or has the vertex colours.
    """
    coloured = mesh.colours is not None
    if source is None:
        surface = surfaces.Diffuse(reflectance=VertexColours() if coloured else _GREY)
        return Material(name, surface, two_sided=True), WHITE if coloured else None
    return _Reader(name, source, mesh, folder).read()


class _Reader:
    def __init__(self, name: str, source: MtlMaterial, mesh: Mesh, folder: ObjFolder) -> None:
        self._name, self._values, self._mesh, self._folder = name, source.values, mesh, folder
        self._maps = dict(source.maps)
        self._ignored = [key for key in self._maps if key not in _USED_MAPS]

    def read(self) -> tuple[Material, RGB | None]:
        surface = self._surface()
        painted = VertexColours() in textures_of(surface)
        if self._mesh.colours is not None and not painted:
            self._ignored.append("vertex colours (glass, metal or map_Kd has the colour)")
        result = Material(
            self._name,
            surface,
            radiance=self._radiance(),
            opacity=1.0 if transmits(surface) else self._opacity(),
            normal_map=self._normal_map(),
            two_sided=True,
        )
        if self._ignored:
            self._warn("not used: " + shown(", ".join(dict.fromkeys(self._ignored)), 300))
        return result, self._rgb("Kd", WHITE) if painted else None

    def _warn(self, text: str) -> None:
        warnings.warn(f"material {shown(self._name)!r}: {text}", LumitreeWarning, stacklevel=2)

    def _surface(self) -> surfaces.Material:
        illum, refraction = int(self._number("illum", 2)), self._number("Ni", 1.0)
        ior = float(min(refraction, 4.0)) if refraction > 1 else 1.5
        see_through = self._coverage() < 1 and "map_d" not in self._maps and refraction > 1
        if illum in _GLASS_ILLUM or see_through:
            return self._glass(ior)
        # `map_Kd` in place of `Kd`, as exporters write it whatever `Kd` says.
        diffuse, specular = self._rgb("Kd", _GREY), self._rgb("Ks", _BLACK)
        colour = diffuse if self._mesh.colours is None else VertexColours()
        base = self._texture("map_Kd", "colour", _colour, raw=False) or colour
        if any(key in self._values or f"map_{key}" in self._maps for key in _PHYSICAL):
            return surfaces.MetallicRoughness(
                base_color=base,
                metallic=self._value("Pm", 0.0),
                roughness=self._value("Pr", 0.5),
                anisotropic=self._unit("aniso", 0.0),
                eta=ior,
                sheen=self._value("Ps", 0.0),
                clearcoat=self._unit("Pc", 0.0),
                clearcoat_roughness=self._unit("Pcr", 0.0),
            )
        # Roughness (root of alpha) of a Phong lobe of exponent `Ns`: alpha² = 2 / (Ns + 2).
        gloss = float((2.0 / (max(self._number("Ns", 0.0), 0.0) + 2.0)) ** 0.25)
        if illum in _MIRROR_ILLUM and max(specular) >= max(diffuse) and max(specular) > 0:
            return metal(specular, gloss)
        if illum not in (0, 1) and max(specular) > 0:
            return surfaces.MetallicRoughness(base_color=base, roughness=gloss, eta=ior)
        return surfaces.Diffuse(reflectance=base)

    def _glass(self, ior: float) -> surfaces.Material:
        solids, pieces = count_solids(self._mesh)
        closed = solids == pieces
        if 0 < solids < pieces:
            self._warn(
                f"{solids} of {pieces} pieces are closed, the others are not; all are taken to be "
                "thin sheets of glass"
            )
        filtered = self._rgb("Tf", WHITE)
        if closed:
            # The light crosses a solid's surface twice.
            filtered = (filtered[0] ** 0.5, filtered[1] ** 0.5, filtered[2] ** 0.5)
        return glass(ior, self._unit("Pr", 0.0), filtered, thin=not closed)

    def _radiance(self) -> Radiance | None:
        red, green, blue = (max(value, 0.0) for value in self._values.get("Ke", _BLACK))
        emits = max(red, green, blue) > 0
        # Where there is a map, Ke may be missing, or black by default; the map is then not scaled.
        factor = (red, green, blue) if emits else WHITE
        role = "radiance", factor
        texture = self._texture("map_Ke", role, lambda image: _radiance(image, factor))
        return texture or (factor if emits else None)

    def _opacity(self) -> Value:
        coverage = self._coverage()
        role = "opacity", coverage
        return self._texture("map_d", role, lambda image: _share(image, coverage)) or coverage

    def _normal_map(self) -> Texture | None:
        """`norm`, or a `bump` image that is one; height maps are not supported."""
        key = "norm" if "norm" in self._maps else "bump"
        if key == "bump" and key in self._maps:
            image = self._image(key)
            if image is not None and not _holds_normals(image):
                self._ignored.append("bump (a height map; expected a normal map)")
                return None
        strength = self._maps[key].bump_scale if key in self._maps else 1.0
        return self._texture(key, ("normals", strength), lambda image: _scaled(image, strength))

    def _value(self, key: str, default: float) -> Value:
        return self._texture(f"map_{key}", "value", _value) or self._unit(key, default)

    def _texture(
        self,
        key: str,
        role: Hashable,
        pick: Callable[[DecodedImage], Image],
        raw: bool = True,
    ) -> Texture | None:
        """Texture of the array that `pick` takes out of a map's image; None for no map.

        `role` is all that `pick` depends on besides the image.
        """
        image = self._image(key)
        if image is None:
            return None
        entry = self._maps[key]
        self._ignored += [f"{key} {option}" for option in entry.ignored]
        if entry.bump_scale != 1 and key not in ("bump", "norm"):
            self._ignored.append(f"{key} -bm")
        # The file counts v from the last row, meshes and textures from the first.
        (su, sv), (ou, ov) = entry.scale, entry.offset
        size = _PIXEL_BYTES * image.pixels.shape[0] * image.pixels.shape[1]
        once, where = (id(image), role), shown(entry.file)
        return Texture(
            image=self._folder.images.made(once, size, where, lambda: pick(image)),
            raw=raw,
            wrap_mode="clamp" if entry.clamp else "repeat",
            to_uv=((su, 0, 0, ou), (0, sv, 0, 1 - sv - ov), (0, 0, 1, 0), (0, 0, 0, 1)),
        )

    def _image(self, key: str) -> DecodedImage | None:
        if key not in self._maps:
            return None
        image = self._folder.image(self._maps[key].file, f"{key} of material {shown(self._name)!r}")
        if image is None:
            del self._maps[key]
        return image

    def _coverage(self) -> float:
        return float(np.clip(self._number("d", 1.0 - self._number("Tr", 0.0)), 0.0, 1.0))

    def _number(self, key: str, default: float) -> float:
        return self._values.get(key, (default,))[0]

    def _unit(self, key: str, default: float) -> float:
        return float(np.clip(self._number(key, default), 0.0, 1.0))

    def _rgb(self, key: str, default: RGB) -> RGB:
        red, green, blue = np.clip(self._values.get(key, default), 0.0, 1.0).tolist()
        return (red, green, blue)


def _colour(image: DecodedImage) -> NDArray[np.uint8]:
    return np.ascontiguousarray(image.pixels[..., :3])


def _value(image: DecodedImage) -> NDArray[np.uint8]:
    return np.ascontiguousarray(image.pixels[..., :1])


def _radiance(image: DecodedImage, factor: RGB) -> NDArray[np.float32]:
    """Linear values [H, W, 3] of sRGB-encoded bytes, times a factor."""
    linear = linear_from_srgb(np.arange(256)[:, None] / 255)
    return looked_up((linear * factor).astype(np.float32), image.pixels[..., :3])


def _share(image: DecodedImage, coverage: float) -> NDArray[np.uint8]:
    """Opacity [H, W, 1]: the alpha channel, or the mean of R, G and B if alpha is 1 throughout."""
    if image.counts[3, :255].any():
        table = np.round(np.arange(256) * coverage).astype(np.uint8)
        return table[image.pixels[..., 3:]]
    table = np.round(np.arange(3 * 255 + 1) / 3 * coverage).astype(np.uint8)
    return table[image.pixels[..., :3].sum(axis=-1, keepdims=True, dtype=np.uint16)]


def _holds_normals(image: DecodedImage) -> bool:
    """Whether most pixels, read as normals, are unit vectors that point out of the image.

    Grey images, such as height maps, are not.
    """
    step = max(1, round((image.pixels.size / _NUM_PROBES) ** 0.5))
    colour = image.pixels[::step, ::step, :3]
    direction = colour.astype(np.float32) / 127.5 - 1
    length = np.linalg.norm(direction, axis=-1)
    outward = (direction[..., 2] > 0.3) & (np.abs(length - 1) < 0.15)
    coloured = np.ptp(colour.astype(np.int16), axis=-1) > 16
    return bool((outward & coloured).mean() > 0.5)


def _scaled(image: DecodedImage, strength: float) -> NDArray[np.uint8]:
    """A normal map with its slopes multiplied by `strength`."""
    if strength == 1:
        return _colour(image)

    def scaled(rows: slice) -> NDArray[np.float32]:
        normal = image.pixels[rows, :, :3].astype(np.float32) / 127.5 - 1
        normal[..., :2] *= strength
        normal /= np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-6)
        return np.round((normal + 1) * 127.5)

    return by_rows(scaled, (*image.pixels.shape[:2], 3), np.uint8)
