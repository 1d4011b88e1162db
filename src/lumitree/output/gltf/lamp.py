"""A lamp as a glTF file: one node that holds its lights and its surfaces.

The lights are those of EXT_lights_ies, whose profiles are in the file, and of KHR_lights_punctual
on the same nodes, for programs that do not know the first.
"""

import math
from collections.abc import Sequence

import numpy as np

from lumitree._version import __version__
from lumitree.asset.asset import Asset
from lumitree.asset.textures import Json
from lumitree.errors import shown
from lumitree.formats.ies import ies_content
from lumitree.output.gltf.glb import INDICES, VERTICES, Glb
from lumitree.output.gltf.materials import GltfMaterials, uses_colours
from lumitree.output.ies_profiles import ProfiledLight
from lumitree.output.pbr_images import PbrImages
from lumitree.output.pbr_meshes import Surface
from lumitree.output.spots import Spot

_PROFILE_TYPE = "application/x-ies-lm-63"
_PUNCTUAL, _PROFILED = "KHR_lights_punctual", "EXT_lights_ies"
# Quaternion of the rotation by -90 degrees about x, from the frame of a light to y up.
_TURN = [-(0.5**0.5), 0.0, 0.0, 0.5**0.5]
# From here on an index needs 32 bits; the largest of 16 bits restarts primitives.
_LONG = (1 << 16) - 1
_NAME_CHARACTERS = 60


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
    if uses_colours(surface.material):
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
        "bufferView": glb.view(ies_content(light.profile)),
        "mimeType": _PROFILE_TYPE,
    }
    number = glb.add_of_extension(_PROFILED, "lights", profile)
    values = {"light": number, "multiplier": light.candela, "color": colour}
    glb.extend(node, _PROFILED, values)
    return glb.add("nodes", node)
