"""Instances of a node's mesh (EXT_mesh_gpu_instancing)."""

import dataclasses

from lumitree.errors import shown_names
from lumitree.lamp.importers.gltf.accessors import Accessors
from lumitree.lamp.importers.gltf.item import MAX_MAGNITUDE
from lumitree.lamp.importers.gltf.nodes import Node, transforms
from lumitree.lamp.importers.gltf.notes import Notes
from lumitree.lamp.parts import check_shapes

# Attributes of an instance: components, and the value of an instance without it.
_ATTRIBUTES = {
    "TRANSLATION": (0.0, 0.0, 0.0),
    "ROTATION": (0.0, 0.0, 0.0, 1.0),
    "SCALE": (1.0, 1.0, 1.0),
}


def instances(node: Node, accessors: Accessors, notes: Notes, others: int) -> list[Node]:
    """The node in the places of its instances; the node itself where it has none.

    `others`, the nodes and instances with meshes before it, count towards the limit.
    """
    extension = node.item.extension("EXT_mesh_gpu_instancing")
    if extension is None:
        return [node]
    attributes = extension.item("attributes")
    if unknown := [name for name in attributes.data if name not in _ATTRIBUTES]:
        notes.file(f"attributes of instances {shown_names(unknown)}")
    used = {name: attributes.integer(name) for name in _ATTRIBUTES if name in attributes}
    counts = {accessors.count(index) for index in used.values()}
    if len(counts) > 1:
        raise attributes.error(f"has accessors of {sorted(counts)} instances; expected one number")
    if not counts:
        return [node]
    check_shapes(others + max(counts), attributes.where)
    values = {
        name: accessors.floats(used[name], (len(default),)) if name in used else default
        for name, default in _ATTRIBUTES.items()
    }
    worlds = node.world @ transforms(
        values["TRANSLATION"], values["ROTATION"], values["SCALE"], attributes
    )
    if abs(worlds).max() > MAX_MAGNITUDE:
        raise attributes.error(f"scales or moves instances beyond {MAX_MAGNITUDE:g}")
    return [dataclasses.replace(node, world=world) for world in worlds]
