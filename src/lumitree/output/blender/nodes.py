"""Trees of Blender's shader nodes as JSON; see `surfaces`."""

from typing import Any

from lumitree.asset.textures import Json
from lumitree.core.mitsuba_meshes import VERTEX_COLOUR

# Shows emission to camera rays and to mirror images of them only. The script names the node, so
# that it can be found.
VISIBLE: Json = {
    "node": "ShaderNodeMath",
    "set": {"operation": "MAXIMUM", "name": "lumitree visible"},
    "inputs": {
        0: {"node": "ShaderNodeLightPath", "output": "Is Camera Ray", "inputs": {}, "set": {}},
        1: {"node": "ShaderNodeLightPath", "output": "Is Singular Ray", "inputs": {}, "set": {}},
    },
    "output": 0,
}
# The lamp's gain, which a driver copies from its empty.
SCALED_GAIN: Json = {
    "node": "ShaderNodeValue",
    "set": {"name": "lumitree gain"},
    "inputs": {},
    "output": 0,
}
# The lamp's factors on red, green and blue, likewise.
TINT: Json = {
    "node": "ShaderNodeCombineXYZ",
    "set": {"name": "lumitree tint"},
    "inputs": {},
    "output": 0,
}
_EXTENSIONS = {"repeat": "REPEAT", "mirror": "MIRROR", "clamp": "EXTEND"}


def node(
    kind: str,
    inputs: dict[Any, Any] | None = None,
    attributes: Json | None = None,
    output: str | int = 0,
) -> Json:
    """Tree of a node."""
    return {"node": kind, "inputs": inputs or {}, "set": attributes or {}, "output": output}


def math(operation: str, *values: Any) -> Json:
    """Tree of an operation on numbers."""
    return node("ShaderNodeMath", dict(enumerate(values)), {"operation": operation})


def mix_shaders(share: Any, first: Json, second: Json) -> Json:
    """Tree of a mixture: `share` is the part of the second."""
    return node("ShaderNodeMixShader", {0: share, 1: first, 2: second})


def add_shaders(first: Json, second: Json) -> Json:
    """Tree of a sum."""
    return node("ShaderNodeAddShader", {0: first, 1: second})


def texture(value: Json) -> Json:
    """Tree of a texture of `asset.materials`.

    Row 0 of its image is at v = 0 in Mitsuba, and at v = 1 in Blender, where v points up as the
    second axis of normal maps does.
    """
    if "attribute" in value:
        return node("ShaderNodeVertexColor", {}, {"layer_name": VERTEX_COLOUR})
    attributes = {
        "interpolation": "Linear" if value["filter_type"] == "bilinear" else "Closest",
        "extension": _EXTENSIONS[value["wrap_mode"]],
    }
    tree = node("ShaderNodeTexImage", {"Vector": _transformed(value["to_uv"])}, attributes)
    # One image of Blender holds colours or data.
    return {**tree, "image": [value["image"], bool(value["raw"])]}


def _transformed(matrix: list[list[float]]) -> Json:
    """Coordinates of a texture, after an affine map of u and v."""
    uv = node("ShaderNodeTexCoord", output="UV")
    (a, b, c), (d, e, f) = ((row[0], row[1], row[3]) for row in matrix[:2])
    # From 1 - v to 1 - v'.
    rows = [[a, -b, b + c], [-d, e, 1 - e - f]]
    if rows == [[1, 0, 0], [0, 1, 0]]:
        return uv
    # (u, v, 0) + (0, 0, 1), so that a product with a row is an affine function.
    homogeneous = vector("ADD", uv, [0.0, 0.0, 1.0])
    products = [vector("DOT_PRODUCT", homogeneous, row, output="Value") for row in rows]
    return node("ShaderNodeCombineXYZ", {0: products[0], 1: products[1]})


def vector(operation: str, *values: Any, output: str | int = 0) -> Json:
    """Tree of an operation on vectors."""
    attributes = {"operation": operation}
    return node("ShaderNodeVectorMath", dict(enumerate(values)), attributes, output)
