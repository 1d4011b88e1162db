"""Materials of an asset's geometry as trees of Blender's shader nodes.

A tree is a JSON object, which the script in `lamp_script` turns into nodes:

    {"node": "ShaderNodeBsdfGlossy", "inputs": {"Color": ..., "Roughness": 0.5}, "set": {...}}

An input is a number, three numbers or a tree. `set` holds attributes of the node. Keys of `inputs`
are names of sockets, or indices where names repeat. `output` names the socket that is used.
"""

from collections.abc import Sequence
from typing import Any

import numpy as np

from lumitree.asset.asset import NO_GAIN
from lumitree.asset.geometry import AssetGeometry
from lumitree.asset.geometry_media import scattering_sides, side_medium
from lumitree.asset.materials import transmits
from lumitree.asset.textures import Json
from lumitree.lamp.scene_writer import normal_reflectance
from lumitree.output.blender.nodes import (
    SCALED_GAIN,
    TINT,
    VISIBLE,
    add_shaders,
    math,
    mix_shaders,
    node,
    texture,
    vector,
)
from lumitree.output.geometry_meshes import MIRRORED_PARTLY, MIXED, Arrays, mirrored_share
from lumitree.output.optics import (
    LOST_REFLECTANCE,
    clearcoat_roughness,
    has_reflectance_factor,
    plastic_index,
    principled_index,
    relative_index,
)

# Properties without an equal in Cycles, by plugin.
_LOST = {
    "thindielectric": "thin glass reflects and transmits without multiple reflections",
    "conductor": "metals have their reflectance at normal incidence for all angles",
    "roughconductor": "metals have their reflectance at normal incidence for all angles",
    "principledthin": "thin sheets are a mixture of diffuse, translucent and transparent",
    "roughdielectric": "emitters behind rough glass are not seen; point lights illuminate it",
}


def absorption_inside(shape: Json) -> list[float] | None:
    """Absorption [3] of the medium inside of a shape, per unit of its file; None for no medium."""
    return side_medium(shape["interior"]).absorption.tolist() if "interior" in shape else None


class Surfaces:
    """Trees for the shapes of an asset's geometry.

    Args:
        geometry: the geometry of an asset.
        gain: [3] factors on the R, G and B of what it emits.

    Attributes:
        lost: one line for each property that is not carried over.
    """

    def __init__(self, geometry: AssetGeometry, gain: tuple[float, float, float] = NO_GAIN) -> None:
        self._geometry, self._gain = geometry, gain
        self.lost: set[str] = set()
        # `mirrored_share` of the shape whose tree is made.
        self._mirrored = 0.0

    def tree(self, shape: Json, mesh: Arrays) -> Json:
        """Tree of a shape's material, with what it emits; `mesh` as of `geometry_meshes`.

        Only camera rays and mirror images show the emission: the point lights illuminate.
        """
        if "exterior" in shape:
            self.lost.add("media outside of a shape are left out")
        if scattering_sides(shape):
            self.lost.add("media absorb light and do not scatter it: opal glass is clear")
        self._mirrored = mirrored_share(mesh)
        surface = self._surface(self._geometry.materials[shape["material"]], None)
        if shape["radiance"] is None:
            return surface
        front = math("SUBTRACT", 1.0, node("ShaderNodeNewGeometry", output="Backfacing"))
        strength = math("MULTIPLY", math("MULTIPLY", front, VISIBLE), SCALED_GAIN)
        colour = _product(self._value(shape["radiance"]), self._gain)
        inputs = {"Color": _times(colour, TINT), "Strength": strength}
        return add_shaders(surface, node("ShaderNodeEmission", inputs))

    def _surface(self, material: Json, normal: Json | None) -> Json:
        """Tree of a material; `normal` is the tree of the shading normal, None for the mesh's."""
        kind = material["type"]
        if kind in _LOST:
            self.lost.add(_LOST[kind])
        inner = material.get("nested", [])
        if kind == "twosided":
            # All surfaces of Blender have two sides, alike.
            if len(inner) == 2:
                back = node("ShaderNodeNewGeometry", output="Backfacing")
                return mix_shaders(back, *(self._surface(each, normal) for each in inner))
            return self._surface(inner[0], normal)
        if kind == "mask":
            opacity = self._value(material.get("opacity", 0.5))
            clear = node("ShaderNodeBsdfTransparent")
            return mix_shaders(opacity, clear, self._surface(inner[0], normal))
        if kind == "blendbsdf":
            weight = self._value(material.get("weight", 0.5))
            return mix_shaders(weight, *(self._surface(each, normal) for each in inner))
        if kind == "normalmap":
            colour = self._value(material["normalmap"])
            if self._mirrored > 0.5:
                colour = vector("MULTIPLY_ADD", colour, [1.0, -1.0, 1.0], [0.0, 1.0, 0.0])
            if MIXED < self._mirrored < 1 - MIXED:
                self.lost.add(MIRRORED_PARTLY)
            return self._surface(inner[0], node("ShaderNodeNormalMap", {"Color": colour}))
        if kind == "bumpmap":
            self.lost.add("bump maps have no scale in lengths, so their depth may differ")
            inputs = {"Height": self._value(material["bumpmap"]), "Distance": 1.0}
            return self._surface(inner[0], node("ShaderNodeBump", inputs))
        if has_reflectance_factor(material):
            self.lost.add(LOST_REFLECTANCE)
        tree = getattr(self, f"_{kind}")(material)
        return _with_normal(tree, normal)

    def _diffuse(self, material: Json) -> Json:
        colour = self._value(material.get("reflectance", 0.5))
        return node("ShaderNodeBsdfDiffuse", {"Color": colour})

    def _dielectric(self, material: Json) -> Json:
        return self._glass(material, 0.0)

    def _roughdielectric(self, material: Json) -> Json:
        return self._glass(material, self._roughness(material))

    def _glass(self, material: Json, roughness: Any) -> Json:
        colour = self._value(material.get("specular_transmittance", 1.0))
        inputs = {"Color": colour, "Roughness": roughness, "IOR": relative_index(material)}
        return node("ShaderNodeBsdfGlass", inputs)

    def _thindielectric(self, material: Json) -> Json:
        fresnel = node("ShaderNodeFresnel", {"IOR": relative_index(material)})
        colour = self._value(material.get("specular_transmittance", 1.0))
        clear = node("ShaderNodeBsdfTransparent", {"Color": colour})
        return mix_shaders(fresnel, clear, self._glossy(1.0, 0.0))

    def _conductor(self, material: Json) -> Json:
        return self._metal(material, 0.0)

    def _roughconductor(self, material: Json) -> Json:
        return self._metal(material, self._roughness(material))

    def _metal(self, material: Json, roughness: Any) -> Json:
        reflectance = normal_reflectance(material)
        tint = self._value(material.get("specular_reflectance", 1.0))
        return self._glossy(_product(tint, reflectance), roughness)

    def _glossy(self, colour: Any, roughness: Any) -> Json:
        return node("ShaderNodeBsdfGlossy", {"Color": colour, "Roughness": roughness})

    def _plastic(self, material: Json) -> Json:
        return self._coated(material, 0.0)

    def _roughplastic(self, material: Json) -> Json:
        return self._coated(material, self._roughness(material))

    def _coated(self, material: Json, roughness: Any) -> Json:
        inputs = {
            "Base Color": self._value(material.get("diffuse_reflectance", 0.5)),
            "Roughness": roughness,
            "IOR": plastic_index(material),
        }
        return node("ShaderNodeBsdfPrincipled", inputs)

    def _principled(self, material: Json) -> Json:
        names = {
            "Base Color": ("base_color", 0.5),
            "Metallic": ("metallic", 0.0),
            "Roughness": ("roughness", 0.5),
            "Anisotropic": ("anisotropic", 0.0),
            "Transmission Weight": ("spec_trans", 0.0),
            "Sheen Weight": ("sheen", 0.0),
            "Coat Weight": ("clearcoat", 0.0),
        }
        inputs = {
            name: self._value(material.get(key, value)) for name, (key, value) in names.items()
        }
        if material.get("flatness") or material.get("spec_tint") or material.get("sheen_tint"):
            self.lost.add("flatness and tints of principled materials are left out")
        inputs["IOR"] = principled_index(material)
        inputs["Coat Roughness"] = clearcoat_roughness(material)
        return node("ShaderNodeBsdfPrincipled", inputs)

    def _lumitree_metallic_roughness(self, material: Json) -> Json:
        if material.get("thin", False) and transmits(material):
            self.lost.add(_LOST["principledthin"])
            return self._principledthin(material)
        tree = self._principled(material)
        level = self._value(material.get("specular", 1.0))
        half = math("MULTIPLY", level, 0.5) if isinstance(level, dict) else level / 2
        coat = self._value(material.get("clearcoat_roughness", 0.0))
        inputs = {**tree["inputs"], "Specular IOR Level": half, "Coat Roughness": coat}
        return {**tree, "inputs": inputs}

    def _principledthin(self, material: Json) -> Json:
        colour = self._value(material.get("base_color", 0.5))
        clear = node("ShaderNodeBsdfTransparent", {"Color": colour})
        front = node("ShaderNodeBsdfDiffuse", {"Color": colour})
        behind = node("ShaderNodeBsdfTranslucent", {"Color": colour})
        half = math("MULTIPLY", self._value(material.get("diff_trans", 0.0)), 0.5)
        scattered = mix_shaders(half, front, behind)
        return mix_shaders(self._value(material.get("spec_trans", 0.0)), scattered, clear)

    def _roughness(self, material: Json) -> Any:
        """Blender's roughness, whose square is the alpha of the microfacets."""
        alphas = [material[name] for name in ("alpha_u", "alpha_v") if name in material]
        if alphas:
            self.lost.add("anisotropic roughness is replaced by that along u")
        alpha = self._value(alphas[0] if alphas else material.get("alpha", 0.1))
        if isinstance(alpha, dict):
            return math("SQRT", alpha)
        return min(float(np.sqrt(alpha)), 1.0)

    def _value(self, value: Any) -> Any:
        if not isinstance(value, dict):
            return value
        return texture(value)


def _with_normal(tree: Json, normal: Json | None) -> Json:
    """The tree with a shading normal for each of its BSDFs that takes one."""
    if normal is None:
        return tree
    inputs = {
        name: _with_normal(value, normal)
        if isinstance(value, dict) and value["node"].startswith(("ShaderNodeBsdf", "ShaderNodeMix"))
        else value
        for name, value in tree["inputs"].items()
    }
    name = tree["node"]
    if name.startswith("ShaderNodeBsdf") and name != "ShaderNodeBsdfTransparent":
        inputs["Normal"] = normal
    return {**tree, "inputs": inputs}


def _product(colour: Any, factors: Sequence[float]) -> Any:
    """Tree, or three numbers, of a colour times a factor on each channel."""
    if all(factor == 1 for factor in factors):
        return colour
    if not isinstance(colour, dict):
        return (np.array(factors) * colour).tolist()
    return _times(colour, list(factors))


def _times(first: Any, second: Any) -> Json:
    attributes = {"data_type": "RGBA", "blend_type": "MULTIPLY"}
    inputs = {"Factor": 1.0, 6: first, 7: second}
    return node("ShaderNodeMix", inputs, attributes, output=2)
