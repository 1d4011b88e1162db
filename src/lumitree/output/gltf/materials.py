"""Materials of glTF: metallic-roughness with the extensions of Khronos."""

from typing import Any

import numpy as np

from lumitree.asset.textures import Json
from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.output.gltf.glb import Glb
from lumitree.output.pbr import Layer, PbrMaterial
from lumitree.output.pbr_images import PbrImages, Pixels, resized
from lumitree.output.pbr_meshes import Surface

_WRAP = {"repeat": 10497, "mirror": 33648, "clamp": 33071}
_FILTERS = {
    "bilinear": {"magFilter": 9729, "minFilter": 9987},
    "nearest": {"magFilter": 9728, "minFilter": 9728},
}
_DEFAULT_INDEX = 1.5


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
        if material.specular != 1:
            self._glb.extend(made, "KHR_materials_specular", {"specularFactor": material.specular})
        elif material.index != _DEFAULT_INDEX and material.metallic.number < 1:
            self._glb.extend(made, "KHR_materials_ior", {"ior": material.index})
        self._add_transmission(made, surface)
        self._add_coats(made, surface)
        return self._glb.add("materials", made)

    def _core(self, made: Json, surface: Surface) -> Json:
        """`pbrMetallicRoughness`; adds the alpha mode to the material."""
        material = surface.material
        core: Json = {}
        colour, opacity = _image_of(material.colour), _image_of(material.opacity)
        alpha, scale = material.opacity.number, 1.0
        if opacity is not None and (colour is None or colour["to_uv"] == opacity["to_uv"]):
            scale = self._add_alpha(made, core, surface)
        else:
            if colour is not None:
                name, scale = self._images.colours(material.colour)
                core["baseColorTexture"] = self._texture(surface, colour, name)
            if opacity is not None:
                self.lost.add("masks with texture coordinates of their own are left out")
            elif alpha < 1:
                made["alphaMode"] = "BLEND"
        factor = np.clip(np.array(material.colour.factor) * scale, 0, 1)
        core["baseColorFactor"] = [*factor.tolist(), alpha]
        self._add_roughness(core, surface)
        return core

    def _add_alpha(self, made: Json, core: Json, surface: Surface) -> float:
        """A texture of the colour whose alpha is the opacity; returns a factor on the colour."""
        material = surface.material
        opacity = _image_of(material.opacity)
        assert opacity is not None
        alpha, scale = self._images.number_pixels(material.opacity), 1.0
        pixels: Pixels = np.full((*alpha.shape, 3), 255, np.uint8)
        if _image_of(material.colour) is not None:
            pixels, scale = self._images.colour_pixels(material.colour)
        alpha = resized(alpha, *pixels.shape[:2])
        name = self._images.add(np.concatenate([pixels, alpha[..., None]], axis=2))
        core["baseColorTexture"] = self._texture(surface, opacity, name)
        made["alphaMode"] = "MASK" if np.isin(alpha, (0, 255)).all() else "BLEND"
        return scale

    def _add_roughness(self, core: Json, surface: Surface) -> None:
        """Roughness in the green channel of a texture, and metalness in the blue one."""
        given = {"roughness": surface.material.roughness, "metallic": surface.material.metallic}
        images = {name: image for name, each in given.items() if (image := _image_of(each))}
        pixels = {name: self._images.number_pixels(given[name]) for name in images}
        for name, layer in given.items():
            core[f"{name}Factor"] = min(layer.number, 1.0)
        if len(images) == 2 and images["roughness"]["to_uv"] != images["metallic"]["to_uv"]:
            self.lost.add("metalness with texture coordinates of its own is replaced by its mean")
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
        emission = surface.material.emission.scaled(LUMENS_PER_WATT)
        factor, image = np.array(emission.factor), _image_of(emission)
        if made.get("alphaMode") == "BLEND":
            # glTF multiplies what is emitted by the opacity, by which it is multiplied already.
            if _image_of(surface.material.opacity) is not None:
                self.lost.add("what emits is dimmed where its opacity is between 0 and 1")
            elif surface.material.opacity.number > 0:
                factor = factor / surface.material.opacity.number
        if image is not None:
            name, scale = self._images.colours(emission)
            factor = factor * scale
            made["emissiveTexture"] = self._texture(surface, image, name)
        strength = float(factor.max())
        made["emissiveFactor"] = (factor / strength).tolist()
        self._glb.extend(made, "KHR_materials_emissive_strength", {"emissiveStrength": strength})

    def _add_transmission(self, made: Json, surface: Surface) -> None:
        material = surface.material
        if material.diffuse_transmission > 0:
            name = "diffuseTransmission"
            diffuse: Json = {f"{name}Factor": material.diffuse_transmission}
            diffuse |= self._coloured(surface, material.colour, f"{name}Color")
            self._glb.extend(made, "KHR_materials_diffuse_transmission", diffuse)
        if material.transmission.is_black:
            return
        values: Json = {"transmissionFactor": material.transmission.number}
        image = _image_of(material.transmission)
        if image is not None:
            name = self._images.data(material.transmission)
            values["transmissionTexture"] = self._texture(surface, image, name)
        self._glb.extend(made, "KHR_materials_transmission", values)
        if material.thin or surface.thickness == 0:
            return
        volume: Json = {"thicknessFactor": surface.thickness}
        if material.absorption is not None and any(material.absorption):
            distance = 1 / max(material.absorption)
            volume["attenuationDistance"] = distance
            volume["attenuationColor"] = np.exp(-np.array(material.absorption) * distance).tolist()
        self._glb.extend(made, "KHR_materials_volume", volume)

    def _add_coats(self, made: Json, surface: Surface) -> None:
        material = surface.material
        if not material.clearcoat.is_black:
            values: Json = {
                "clearcoatFactor": material.clearcoat.number,
                "clearcoatRoughnessFactor": material.clearcoat_roughness,
            }
            image = _image_of(material.clearcoat)
            if image is not None:
                name = self._images.data(material.clearcoat)
                values["clearcoatTexture"] = self._texture(surface, image, name)
            self._glb.extend(made, "KHR_materials_clearcoat", values)
        if not material.sheen.is_black:
            values = self._coloured(surface, material.sheen, "sheenColor")
            self._glb.extend(made, "KHR_materials_sheen", values)

    def _coloured(self, surface: Surface, layer: Layer, name: str) -> Json:
        """A colour of a name: its factor, and its texture if it has one."""
        image = _image_of(layer)
        if image is None:
            return {f"{name}Factor": list(layer.factor)}
        file, scale = self._images.colours(layer)
        factor = (np.array(layer.factor) * scale).tolist()
        return {f"{name}Factor": factor, f"{name}Texture": self._texture(surface, image, file)}

    def _texture(self, surface: Surface, texture: Json, name: str) -> Json:
        """Information of a texture with the image of a name."""
        if name not in self._sources:
            view = self._glb.view(self._images.files[name])
            source = {"bufferView": view, "mimeType": "image/png", "name": name}
            self._sources[name] = self._glb.add("images", source)
        kind = texture["wrap_mode"], texture["filter_type"]
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


def _image_of(layer: Layer) -> Json | None:
    found: Any = layer.texture
    return found if found is not None and "image" in found else None


def uses_colours(material: PbrMaterial) -> bool:
    """Whether the colours of vertices are the colour of a material."""
    return material.colour.texture is not None and "attribute" in material.colour.texture
