"""The binary glTF file that Blender's exporter writes, changed for lumitree."""

import json
import struct
from collections.abc import Sequence
from typing import Any

from .light import LUMENS_PER_WATT

_STRENGTH, _VOLUME = "KHR_materials_emissive_strength", "KHR_materials_volume"
_TRANSMISSION = "KHR_materials_transmission"


def prepared(content: bytes, centre: Sequence[float]) -> bytes:
    """The file with emission and glass as Cycles has them, and relative to a point.

    Args:
        content: of a binary glTF file.
        centre: [3] the point that becomes the origin, m, z up as in Blender.
    """
    (length,) = struct.unpack_from("<I", content, 12)
    root = json.loads(content[20 : 20 + length])
    for material in root.get("materials", []):
        _as_in_cycles(material, root.setdefault("extensionsUsed", []))
    scene, nodes = root["scenes"][root.get("scene", 0)], root["nodes"]
    x, y, z = centre
    nodes.append({"name": "lamp", "translation": [-x, -z, y], "children": scene["nodes"]})
    scene["nodes"] = [len(nodes) - 1]
    text = json.dumps(root).encode()
    text += b" " * (-len(text) % 4)
    chunks = struct.pack("<I4s", len(text), b"JSON") + text + content[20 + length :]
    return struct.pack("<4sII", b"glTF", 2, 12 + len(chunks)) + chunks


def _as_in_cycles(material: dict[str, Any], used: list[str]) -> None:
    """Change a material. `used` gets the extensions that it uses then."""
    extensions = material.setdefault("extensions", {})
    if "emissiveFactor" in material:
        # Blender writes a radiance, W/(m² sr), as it is. glTF has luminances, cd/m².
        strength = extensions.setdefault(_STRENGTH, {})
        strength["emissiveStrength"] = strength.get("emissiveStrength", 1.0) * LUMENS_PER_WATT
    if _TRANSMISSION in extensions and _VOLUME not in extensions:
        # Without a thickness glass is a thin sheet; with one it is solid where the mesh is closed.
        extensions[_VOLUME] = {"thicknessFactor": 1.0}
    used += [name for name in extensions if name not in used]
