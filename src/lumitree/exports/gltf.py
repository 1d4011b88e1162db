"""glTF: one binary file with the lamp's lights and surfaces.

Each light is one of EXT_lights_ies, whose profiles are in the file, and one of KHR_lights_punctual
on the same node, for programs that do not know the first. Materials are metallic-roughness with the
extensions of Khronos.
"""

import math
import struct
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree._version import __version__
from lumitree.asset.asset import Asset
from lumitree.asset.materials import Texture, VertexColours
from lumitree.core.files import json_text
from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.core.results import Json
from lumitree.errors import shown
from lumitree.exports.light_profiles import LOST_COLOUR, ProfiledLight, Spot, profiled_lights
from lumitree.exports.pbr import Layer
from lumitree.exports.point_lights import turn_up
from lumitree.exports.surfaces import LOST_GLOW, PbrImages, Pixels, Surface, resized, surfaces_of
from lumitree.exports.target import (
    LOST_IN_BLENDER,
    ExportRequest,
    Target,
    Written,
    blender_spots,
)
from lumitree.formats.ies import ies_content

_LOST_DIRECTIONS = (
    "programs without EXT_lights_ies show lights that emit the same in all directions; programs "
    "that show both kinds of lights show twice the light"
)
_LOST_SHADOW_LINKS = (
    "the lamp's surfaces shade its lights, which include that shade already; where the program "
    "can, let the surfaces cast no shadows"
)
_PROFILE_TYPE = "application/x-ies-lm-63"
_PUNCTUAL, _PROFILED = "KHR_lights_punctual", "EXT_lights_ies"
# Quaternion of the rotation by -90 degrees about x, from the frame of a light to y up.
_TURN = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
# From here on an index needs 32 bits; the largest of 16 bits restarts primitives.
_LONG = (1 << 16) - 1
_NAME_CHARACTERS = 60
_WRAP = {"repeat": 10497, "mirror": 33648, "clamp": 33071}
_FILTERS = {
    "bilinear": {"magFilter": 9729, "minFilter": 9987},
    "nearest": {"magFilter": 9728, "minFilter": 9728},
}
_DEFAULT_INDEX = 1.5
VERTICES, INDICES = 34962, 34963
_TYPES = {1: "SCALAR", 2: "VEC2", 3: "VEC3"}
_COMPONENTS = {"float32": 5126, "uint16": 5123, "uint32": 5125}
_MAGIC, _VERSION, _JSON, _BINARY = b"glTF", 2, b"JSON", b"BIN\0"
_ALIGNMENT = 4


class Glb:
    """A file that grows call by call; `json` lacks `buffers` and `extensionsUsed`."""

    def __init__(self, generator: str) -> None:
        asset = {"version": "2.0", "generator": generator}
        self.json: Json = {"asset": asset, "scene": 0, "scenes": [{"nodes": []}]}
        self._data = bytearray()
        self._used: set[str] = set()

    def add(self, kind: str, item: Json) -> int:
        """Add an item to a list, such as "nodes"; returns its index."""
        items = self.json.setdefault(kind, [])
        items.append(item)
        return len(items) - 1

    def add_of_extension(self, extension: str, kind: str, item: Json) -> int:
        """Add an item to a list of an extension of the file; returns its index."""
        self._used.add(extension)
        items = self.json.setdefault("extensions", {}).setdefault(extension, {})
        items.setdefault(kind, []).append(item)
        return len(items[kind]) - 1

    def extend(self, item: Json, extension: str, values: Json) -> None:
        """Add an extension to an item."""
        self._used.add(extension)
        item.setdefault("extensions", {})[extension] = values

    def buffer_view(self, data: bytes, target: int | None = None) -> int:
        """Add bytes; returns the index of their buffer view."""
        self._data += b"\0" * (-len(self._data) % _ALIGNMENT)
        view: Json = {"buffer": 0, "byteOffset": len(self._data), "byteLength": len(data)}
        if target is not None:
            view["target"] = target
        self._data += data
        return self.add("bufferViews", view)

    def accessor(self, array: NDArray[np.number], target: int) -> int:
        """Add numbers [N] or [N, 2 or 3], with their bounds; returns the index of the accessor."""
        columns = array.reshape(len(array), -1)
        return self.add(
            "accessors",
            {
                "bufferView": self.buffer_view(np.ascontiguousarray(array).tobytes(), target),
                "componentType": _COMPONENTS[array.dtype.name],
                "count": len(array),
                "type": _TYPES[columns.shape[1]],
                "min": columns.min(axis=0).tolist(),
                "max": columns.max(axis=0).tolist(),
            },
        )

    def content(self) -> bytes:
        """The file."""
        self._data += b"\0" * (-len(self._data) % _ALIGNMENT)
        made = dict(self.json)
        if self._data:
            made["buffers"] = [{"byteLength": len(self._data)}]
        if self._used:
            made["extensionsUsed"] = sorted(self._used)
        text = json_text(made).encode()
        text += b" " * (-len(text) % _ALIGNMENT)
        chunks = struct.pack("<I4s", len(text), _JSON) + text
        if self._data:
            chunks += struct.pack("<I4s", len(self._data), _BINARY) + bytes(self._data)
        return struct.pack("<4sII", _MAGIC, _VERSION, 12 + len(chunks)) + chunks


class GltfMaterials:
    """Adds materials to a file; `lost` has one line for each property that is not carried over."""

    def __init__(self, glb: Glb, images: PbrImages) -> None:
        self._glb, self._images = glb, images
        self._sources: dict[str, int] = {}
        self._samplers: dict[tuple[str, str], int] = {}
        self._textures: dict[tuple[int, int], int] = {}
        self.lost: set[str] = set()

    def add(self, index: int, surface: Surface) -> int:
        """Add the material of a surface; returns its index."""
        material = surface.material
        made: Json = {"name": f"material{index}", "doubleSided": material.two_sided}
        made["pbrMetallicRoughness"] = self._core(made, surface)
        if material.normal is not None:
            name = self._images.normals(material.normal, material.normal_mirrored)
            made["normalTexture"] = self._texture(surface, material.normal, name)
        if not material.emission.is_black:
            self._add_emission(made, surface)
        if (specular := material.specular.number) != 1:
            self._glb.extend(made, "KHR_materials_specular", {"specularFactor": specular})
        elif material.index != _DEFAULT_INDEX and material.metallic.number < 1:
            self._glb.extend(made, "KHR_materials_ior", {"ior": material.index})
        self._add_transmission(made, surface)
        if not material.clearcoat.is_black:
            values = self._layer(surface, material.clearcoat, "clearcoat")
            values["clearcoatRoughnessFactor"] = material.clearcoat_roughness.number
            self._glb.extend(made, "KHR_materials_clearcoat", values)
        if not material.sheen.is_black:
            values = self._layer(surface, material.sheen, "sheenColor", colour=True)
            self._glb.extend(made, "KHR_materials_sheen", values)
        return self._glb.add("materials", made)

    def _core(self, made: Json, surface: Surface) -> Json:
        """`pbrMetallicRoughness`; adds the alpha mode to the material."""
        material = surface.material
        core: Json = {}
        colour, opacity = material.colour.image, material.opacity.image
        alpha, scale = material.opacity.number, 1.0
        if opacity is not None and (colour is None or colour.to_uv == opacity.to_uv):
            scale = self._add_alpha(made, core, surface)
        else:
            if colour is not None:
                name, scale = self._images.colours(material.colour)
                core["baseColorTexture"] = self._texture(surface, colour, name)
            if opacity is not None:
                self.lost.add("masks with other texture coordinates than the colour are dropped")
            elif alpha < 1:
                made["alphaMode"] = "BLEND"
        factor = np.clip(np.array(material.colour.factor) * scale, 0, 1)
        core["baseColorFactor"] = [*factor.tolist(), alpha]
        self._add_roughness(core, surface)
        return core

    def _add_alpha(self, made: Json, core: Json, surface: Surface) -> float:
        """A texture of the colour whose alpha is the opacity; returns a factor on the colour."""
        material = surface.material
        opacity = material.opacity.image
        assert opacity is not None
        alpha, scale = self._images.number_pixels(material.opacity), 1.0
        pixels: Pixels = np.full((*alpha.shape, 3), 255, np.uint8)
        if material.colour.image is not None:
            pixels, scale = self._images.colour_pixels(material.colour)
        alpha = resized(alpha, *pixels.shape[:2])
        name = self._images.add(np.concatenate([pixels, alpha[..., None]], axis=2))
        core["baseColorTexture"] = self._texture(surface, opacity, name)
        made["alphaMode"] = "MASK" if np.isin(alpha, (0, 255)).all() else "BLEND"
        return scale

    def _add_roughness(self, core: Json, surface: Surface) -> None:
        """Roughness in the green channel of a texture, and metalness in the blue one."""
        given = {"roughness": surface.material.roughness, "metallic": surface.material.metallic}
        images = {name: image for name, each in given.items() if (image := each.image)}
        pixels = {name: self._images.number_pixels(given[name]) for name in images}
        for name, layer in given.items():
            core[f"{name}Factor"] = min(layer.number, 1.0)
        if len(images) == 2 and images["roughness"].to_uv != images["metallic"].to_uv:
            self.lost.add(
                "metalness with other texture coordinates than roughness is replaced by its mean"
            )
            core["metallicFactor"] *= float(pixels.pop("metallic").mean()) / 255
        if not pixels:
            return
        shape = next(iter(pixels.values())).shape
        white = np.full(shape, 255, np.uint8)
        channels = [white, *(resized(pixels.get(name, white), *shape) for name in given)]
        file = self._images.add(np.stack(channels, axis=-1))
        texture = images[next(iter(pixels))]
        core["metallicRoughnessTexture"] = self._texture(surface, texture, file)

    def _add_emission(self, made: Json, surface: Surface) -> None:
        opacity, emission = surface.material.opacity, surface.material.emission
        if made.get("alphaMode") == "BLEND":
            # glTF multiplies emission by the opacity, which the radiance includes already.
            if opacity.image is not None:
                self.lost.add("what emits is dimmed where its opacity is between 0 and 1")
            elif opacity.number > 0:
                emission = emission.scaled(1 / opacity.number)
        members = self._layer(surface, emission.scaled(LUMENS_PER_WATT), "emissive", colour=True)
        factor = np.array(members["emissiveFactor"])
        strength = float(factor.max())
        made |= members | {"emissiveFactor": (factor / strength).tolist()}
        self._glb.extend(made, "KHR_materials_emissive_strength", {"emissiveStrength": strength})

    def _add_transmission(self, made: Json, surface: Surface) -> None:
        material = surface.material
        if not material.diffuse_transmission.is_black:
            half = {"diffuseTransmissionFactor": material.diffuse_transmission.number / 2}
            colour = self._layer(surface, material.colour, "diffuseTransmissionColor", colour=True)
            self._glb.extend(made, "KHR_materials_diffuse_transmission", half | colour)
        if material.transmission.is_black:
            return
        values = self._layer(surface, material.transmission, "transmission")
        self._glb.extend(made, "KHR_materials_transmission", values)
        if material.thin or surface.thickness == 0:
            return
        volume: Json = {"thicknessFactor": surface.thickness}
        if material.absorption is not None and any(material.absorption):
            distance = 1 / max(material.absorption)
            volume["attenuationDistance"] = distance
            volume["attenuationColor"] = np.exp(-np.array(material.absorption) * distance).tolist()
        self._glb.extend(made, "KHR_materials_volume", volume)

    def _layer(self, surface: Surface, layer: Layer, name: str, *, colour: bool = False) -> Json:
        """Members of a layer of a name: its factor, and its texture if it is an image."""
        found: Json = {f"{name}Factor": layer.number}
        scale = 1.0
        if layer.image is not None:
            file = self._images.colours(layer) if colour else (self._images.data(layer), 1.0)
            found[f"{name}Texture"] = self._texture(surface, layer.image, file[0])
            scale = file[1]
        if colour:
            found[f"{name}Factor"] = list(layer.scaled(scale).factor)
        return found

    def _texture(self, surface: Surface, texture: Texture, name: str) -> Json:
        """Information of a texture with the image of a name."""
        if name not in self._sources:
            view = self._glb.buffer_view(self._images.files[name])
            source = {"bufferView": view, "mimeType": "image/png", "name": name}
            self._sources[name] = self._glb.add("images", source)
        kind = texture.wrap_mode, texture.filter_type
        if kind not in self._samplers:
            wrap = _WRAP[kind[0]]
            sampler = {**_FILTERS[kind[1]], "wrapS": wrap, "wrapT": wrap}
            self._samplers[kind] = self._glb.add("samplers", sampler)
        key = self._sources[name], self._samplers[kind]
        if key not in self._textures:
            made = {"source": key[0], "sampler": key[1]}
            self._textures[key] = self._glb.add("textures", made)
        uv_set = surface.uv_set(texture)
        return {"index": self._textures[key]} | ({"texCoord": uv_set} if uv_set else {})


def lamp_glb(
    asset: Asset, lights: Sequence[ProfiledLight | Spot], surfaces: Sequence[Surface]
) -> tuple[bytes, list[str]]:
    """The file of a lamp, and one line for each property that it does not carry over."""
    glb = Glb(f"lumitree {__version__}")
    children: list[int] = []
    lost: list[str] = []
    if surfaces:
        assert asset.geometry is not None
        materials = GltfMaterials(glb, PbrImages(asset.geometry.images))
        nodes = [
            _add_surface(glb, index, surface, materials) for index, surface in enumerate(surfaces)
        ]
        children.append(glb.add("nodes", {"name": "surfaces", "children": nodes}))
        lost = sorted(materials.lost)
    nodes = [_add_light(glb, index, light) for index, light in enumerate(lights)]
    children.append(glb.add("nodes", {"name": "lights", "children": nodes}))
    name = shown(asset.luminaire, _NAME_CHARACTERS)
    root = glb.add("nodes", {"name": name, "children": children})
    glb.json["scenes"][0]["nodes"] = [root]
    return glb.content(), lost


def _add_surface(glb: Glb, index: int, surface: Surface, materials: GltfMaterials) -> int:
    arrays, name = surface.mesh, f"surface{index}"
    attributes = {"POSITION": glb.accessor(arrays["vertices"], VERTICES)}
    if "normals" in arrays:
        attributes["NORMAL"] = glb.accessor(arrays["normals"], VERTICES)
    for number, places in enumerate(surface.uv):
        attributes[f"TEXCOORD_{number}"] = glb.accessor(places, VERTICES)
    if isinstance(surface.material.colour.texture, VertexColours):
        attributes["COLOR_0"] = glb.accessor(arrays["colours"], VERTICES)
    small = len(arrays["vertices"]) <= _LONG
    indices = arrays["faces"].ravel().astype(np.uint16 if small else np.uint32)
    primitive: Json = {
        "attributes": attributes,
        "indices": glb.accessor(indices, INDICES),
        "material": materials.add(index, surface),
    }
    mesh = glb.add("meshes", {"name": name, "primitives": [primitive]})
    return glb.add("nodes", {"name": name, "mesh": mesh})


def _add_light(glb: Glb, index: int, light: ProfiledLight | Spot) -> int:
    name, colour = f"light{index}", list(light.colour)
    point: Json = {"type": "point", "name": name, "color": colour, "intensity": light.candela}
    node: Json = {"name": name, "translation": light.position.tolist(), "rotation": _TURN}
    if isinstance(light, Spot):
        cone = {"innerConeAngle": 0.0, "outerConeAngle": math.radians(light.half_angle)}
        point |= {"type": "spot", "spot": cone}
        node["rotation"] = light.rotation
    glb.extend(node, _PUNCTUAL, {"light": glb.add_of_extension(_PUNCTUAL, "lights", point)})
    if isinstance(light, Spot):
        return glb.add("nodes", node)
    profile = {
        "name": name,
        "bufferView": glb.buffer_view(ies_content(light.profile)),
        "mimeType": _PROFILE_TYPE,
    }
    number = glb.add_of_extension(_PROFILED, "lights", profile)
    values = {"light": number, "multiplier": light.candela, "color": colour}
    glb.extend(node, _PROFILED, values)
    return glb.add("nodes", node)


def _write(request: ExportRequest, folder: Path) -> Written:
    if request.importer == "blender":
        spots, written = blender_spots(request)
        (folder / request.name).write_bytes(lamp_glb(request.asset, spots, [])[0])
        return written
    lights = profiled_lights(request.place("y"), request.asset.luminaire)
    surfaces, lost = surfaces_of(request.asset, turn_up(request.up, "y"))
    content, more = lamp_glb(request.asset, lights, surfaces)
    (folder / request.name).write_bytes(content)
    if surfaces:
        lost = [_LOST_SHADOW_LINKS, *sorted({*lost, *more})]
    if any(not surface.material.emission.is_black for surface in surfaces):
        lost.append(LOST_GLOW)
    return Written(
        not_carried_over=[LOST_IN_BLENDER, _LOST_DIRECTIONS, LOST_COLOUR, *lost],
        lights=len(lights),
        triangles=sum(len(surface.mesh["faces"]) for surface in surfaces),
    )


TARGET = Target(
    name="glTF",
    write=_write,
    up="y",
    units="metres; cd and cd/m² (683 times W/sr and W/(m² sr))",
    importers=True,
)
