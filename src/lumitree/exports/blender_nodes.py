"""Materials of an asset's geometry as trees of Blender's shader nodes.

A tree is a JSON object, which `blender_files/lamp_script.py` turns into nodes:

    {"node": "ShaderNodeBsdfGlossy", "inputs": {"Color": ..., "Roughness": 0.5}, "set": {...}}

An input is a number, three numbers or a tree. `set` gives attributes of the node. Keys of `inputs`
are names of sockets, or indices where names repeat. `output` names the socket that is used.
"""

from collections.abc import Mapping, Sequence
from typing import NotRequired, TypedDict

from lumitree.asset.asset import UNIT_FACTORS
from lumitree.asset.geometry import AssetGeometry, MeshArrays, Shape
from lumitree.asset.materials import (
    Blend,
    BumpMap,
    Diffuse,
    Glass,
    Mask,
    Material,
    Matrix,
    Metal,
    MetallicRoughness,
    NormalMap,
    PrincipledThin,
    RoughDielectric,
    Texture,
    ThinDielectric,
    TwoSided,
    VertexColours,
    transmits,
)
from lumitree.core.mitsuba_meshes import VERTEX_COLOUR
from lumitree.core.photometry import RGB
from lumitree.exports.pbr import Layer, PbrMaterial, converted, layer, lost_media
from lumitree.exports.surfaces import lost_by_mirroring, mirrored_share


class Tree(TypedDict):
    """A node, see above."""

    node: str
    inputs: "Inputs"
    set: Mapping[str, str]
    output: str | int
    image: NotRequired[tuple[int, bool]]


Input = float | Sequence[float] | Tree
Inputs = Mapping[str, Input] | Mapping[int, Input] | Mapping[str | int, Input]
_UNCONNECTED: Mapping[str, Input] = {}
_UNCHANGED: Mapping[str, str] = {}

_EXTENSIONS = {"repeat": "REPEAT", "mirror": "MIRROR", "clamp": "EXTEND"}


class BlenderMaterials:
    """Trees for the shapes of an asset's geometry.

    Args:
        geometry: the geometry of an asset.
        factors: [3] on the R, G and B of its emission (`Asset.light_factors`).

    Attributes:
        lost: one line for each property that is not carried over.
    """

    def __init__(self, geometry: AssetGeometry, factors: RGB = UNIT_FACTORS) -> None:
        self._geometry, self._factors = geometry, factors
        self.lost: set[str] = set()
        # `mirrored_share` of the shape whose tree is made.
        self._mirrored = 0.0

    def tree(self, shape: Shape, mesh: MeshArrays) -> Tree:
        """Tree of a shape's material and emission; `mesh` as of `geometry_meshes`.

        Only camera rays and mirror images show the emission: the point lights illuminate.
        """
        self.lost.update(lost_media(shape))
        self._mirrored = mirrored_share(mesh)
        surface = self._surface(self._geometry.materials[shape.material], None)
        if shape.radiance is None:
            return surface
        front = _math("SUBTRACT", 1.0, node("ShaderNodeNewGeometry", output="Backfacing"))
        strength = _math("MULTIPLY", _math("MULTIPLY", front, _VISIBLE), _LAMP_GAIN)
        colour = _times(_value(layer(shape.radiance).scaled(self._factors)), _LAMP_TINT)
        emission = node("ShaderNodeEmission", {"Color": colour, "Strength": strength})
        return node("ShaderNodeAddShader", {0: surface, 1: emission})

    def _surface(self, material: Material, normal: Tree | None) -> Tree:
        """Tree of a material; `normal` is the tree of the shading normal, None for the mesh's."""
        match material:
            # All surfaces of Blender have two sides, alike.
            case TwoSided(nested=(inner,)):
                return self._surface(inner, normal)
            case TwoSided(nested=(front, behind)):
                back = node("ShaderNodeNewGeometry", output="Backfacing")
                return _mix(back, self._surface(front, normal), self._surface(behind, normal))
            case Mask(nested=(inner,)):
                opacity = _value(layer(material.opacity, 0.5))
                clear = node("ShaderNodeBsdfTransparent")
                return _mix(opacity, clear, self._surface(inner, normal))
            case Blend(nested=(first, second)):
                weight = _value(layer(material.weight))
                return _mix(weight, self._surface(first, normal), self._surface(second, normal))
            case NormalMap(nested=(inner,)):
                colour = texture(material.normalmap)
                if self._mirrored > 0.5:
                    turned = [1.0, -1.0, 1.0], [0.0, 1.0, 0.0]
                    colour = _vector("MULTIPLY_ADD", colour, *turned)
                self.lost |= lost_by_mirroring(self._mirrored)
                return self._surface(inner, node("ShaderNodeNormalMap", {"Color": colour}))
            case BumpMap(nested=(inner,)):
                self.lost.add("bump maps have no scale in lengths, so their depth may differ")
                inputs = {"Height": texture(material.bumpmap), "Distance": 1.0}
                return self._surface(inner, node("ShaderNodeBump", inputs))
            case _:
                return _with_normal(self._plain(material), normal)

    def _plain(self, material: Material) -> Tree:
        """Tree of a material without nested ones."""
        found = converted(material)
        self.lost |= found.lost
        match material:
            case Diffuse():
                return node("ShaderNodeBsdfDiffuse", {"Color": _value(found.colour)})
            case ThinDielectric():
                self.lost.add("thin glass reflects and transmits without multiple reflections")
                fresnel = node("ShaderNodeFresnel", {"IOR": found.index})
                clear = node("ShaderNodeBsdfTransparent", {"Color": _value(found.colour)})
                return _mix(fresnel, clear, _glossy(1.0, 0.0))
            case Glass():
                if isinstance(material, RoughDielectric):
                    self.lost.add(
                        "emitters behind rough glass are not seen; point lights illuminate it"
                    )
                # The colour of the material multiplies light that crosses both surfaces.
                inputs = {"Color": _value(found.colour.root()), "IOR": found.index}
                return node("ShaderNodeBsdfGlass", inputs | {"Roughness": _roughness(found)})
            case Metal():
                return _glossy(_value(found.colour), _roughness(found))
            case PrincipledThin():
                return self._sheet(found)
            case MetallicRoughness() if found.thin and transmits(material):
                return self._sheet(found)
            case _:
                return _principled(found)

    def _sheet(self, material: PbrMaterial) -> Tree:
        self.lost.add("thin sheets are a mixture of diffuse, translucent and transparent")
        colour = {"Color": _value(material.colour)}
        front, behind = (
            node("ShaderNodeBsdfDiffuse", colour),
            node("ShaderNodeBsdfTranslucent", colour),
        )
        half = _value(material.diffuse_transmission.scaled(0.5))
        clear = node("ShaderNodeBsdfTransparent", colour)
        return _mix(_value(material.transmission), _mix(half, front, behind), clear)


def _principled(material: PbrMaterial) -> Tree:
    inputs: dict[str, Input] = {
        "Base Color": _value(material.colour),
        "Metallic": _value(material.metallic),
        "Roughness": _roughness(material),
        "Anisotropic": _value(material.anisotropy),
        "Transmission Weight": _value(material.transmission),
        "Sheen Weight": _value(material.sheen),
        "Coat Weight": _value(material.clearcoat),
        "Coat Roughness": _value(material.clearcoat_roughness),
        "IOR": material.index,
        # Cycles has Fresnel's reflectance at a level of 1/2.
        "Specular IOR Level": _value(material.specular.scaled(0.5)),
    }
    return node("ShaderNodeBsdfPrincipled", inputs)


def _glossy(colour: Input, roughness: Input) -> Tree:
    return node("ShaderNodeBsdfGlossy", {"Color": colour, "Roughness": roughness})


def _roughness(material: PbrMaterial) -> Input:
    value = _value(material.roughness)
    return min(value, 1.0) if isinstance(value, float) else value


def _value(given: Layer) -> Input:
    """A number, three numbers, or the tree of a texture times them."""
    red, green, blue = given.factor
    if given.texture is None:
        return red if red == green == blue else [red, green, blue]
    tree = texture(given.texture)
    if given.exponent == 0.5:
        tree = _math("SQRT", tree)
    return tree if red == green == blue == 1 else _times(tree, [red, green, blue])


def _times(first: Input, second: Input) -> Tree:
    attributes = {"data_type": "RGBA", "blend_type": "MULTIPLY"}
    inputs = {"Factor": 1.0, 6: first, 7: second}
    return node("ShaderNodeMix", inputs, attributes, output=2)


def _with_normal(tree: Tree, normal: Tree | None) -> Tree:
    """The tree with a shading normal for each of its BSDFs that takes one."""
    if normal is None:
        return tree
    inputs: dict[str | int, Input] = {
        name: _with_normal(value, normal)
        if isinstance(value, dict) and value["node"].startswith(("ShaderNodeBsdf", "ShaderNodeMix"))
        else value
        for name, value in tree["inputs"].items()
    }
    name = tree["node"]
    if name.startswith("ShaderNodeBsdf") and name != "ShaderNodeBsdfTransparent":
        inputs["Normal"] = normal
    return {**tree, "inputs": inputs}


def node(
    kind: str,
    inputs: Inputs = _UNCONNECTED,
    attributes: Mapping[str, str] = _UNCHANGED,
    output: str | int = 0,
) -> Tree:
    """Tree of a node."""
    return {"node": kind, "inputs": inputs, "set": attributes, "output": output}


def texture(value: Texture | VertexColours) -> Tree:
    """Tree of a texture.

    Row 0 of its image is at v = 0 in Mitsuba, and at v = 1 in Blender, where v points up as the
    second axis of normal maps does.
    """
    if isinstance(value, VertexColours):
        return node("ShaderNodeVertexColor", {}, {"layer_name": VERTEX_COLOUR})
    attributes = {
        "interpolation": "Linear" if value.filter_type == "bilinear" else "Closest",
        "extension": _EXTENSIONS[value.wrap_mode],
    }
    tree = node("ShaderNodeTexImage", {"Vector": _mapped(value.to_uv)}, attributes)
    # One image of Blender has either colours or data.
    return {**tree, "image": (value.image, value.raw)}


def _mapped(matrix: Matrix) -> Tree:
    """Coordinates of a texture, after an affine map of u and v."""
    uv = node("ShaderNodeTexCoord", output="UV")
    (a, b, c), (d, e, f) = ((row[0], row[1], row[3]) for row in matrix[:2])
    # From 1 - v to 1 - v'.
    rows = [[a, -b, b + c], [-d, e, 1 - e - f]]
    if rows == [[1, 0, 0], [0, 1, 0]]:
        return uv
    # (u, v, 0) + (0, 0, 1), so that a product with a row is an affine function.
    homogeneous = _vector("ADD", uv, [0.0, 0.0, 1.0])
    first, second = (_vector("DOT_PRODUCT", homogeneous, row, output="Value") for row in rows)
    return node("ShaderNodeCombineXYZ", {0: first, 1: second})


def _math(operation: str, *values: Input) -> Tree:
    """Tree of an operation on numbers."""
    return node("ShaderNodeMath", dict(enumerate(values)), {"operation": operation})


def _vector(operation: str, *values: Input, output: str | int = 0) -> Tree:
    """Tree of an operation on vectors."""
    attributes = {"operation": operation}
    return node("ShaderNodeVectorMath", dict(enumerate(values)), attributes, output)


def _mix(share: Input, first: Tree, second: Tree) -> Tree:
    """Tree of a mixture of shaders: `share` is the part of the second."""
    return node("ShaderNodeMixShader", {0: share, 1: first, 2: second})


# Shows emission to camera rays and to mirror images of them only. The script finds this node, and
# the next two, by their names.
_VISIBLE = node(
    "ShaderNodeMath",
    {
        0: node("ShaderNodeLightPath", output="Is Camera Ray"),
        1: node("ShaderNodeLightPath", output="Is Singular Ray"),
    },
    {"operation": "MAXIMUM", "name": "lumitree visible"},
)
# The gain of the lamp in Blender and its factors on red, green and blue: drivers copy them from its
# empty.
_LAMP_GAIN = node("ShaderNodeValue", {}, {"name": "lumitree gain"})
_LAMP_TINT = node("ShaderNodeCombineXYZ", {}, {"name": "lumitree tint"})
