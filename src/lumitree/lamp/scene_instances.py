"""Instances of a parsed scene as copies of the shapes of their groups."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.backend import load_mitsuba


def copy_instances(state: Any) -> frozenset[int]:
    """Replace the instances of a parsed scene by copies, which are placed in double precision.

    `state` is mi.parser.ParserState, after `transform_all`. Returns numbers of the nodes that are
    copies of mirrored instances: Mitsuba turns the normals of a mesh whose own transform mirrors
    it, but not the normals of a mirrored instance.
    """
    mi = load_mitsuba()
    root = state.nodes[0].props
    groups, copies, mirrored = [], [], set[int]()
    for key, index in referred(root).items():
        props = state.nodes[index].props
        match props.plugin_name():
            case "shapegroup":
                groups.append(key)
            case "instance":
                (group,) = referred(props).values()
                members = referred(state.nodes[group].props).values()
                copies.append((key, members, matrix_of(props)))
    for key, members, matrix in copies:
        for member in members:
            node, copied = state.nodes[member], mi.parser.SceneNode()
            copied.type, copied.props = node.type, mi.Properties(node.props)
            copied.file_index, copied.offset = node.file_index, node.offset
            place = matrix @ matrix_of(node.props)
            copied.props["to_world"] = mi.ScalarTransform4d(place)
            number = len(state.nodes)
            if np.linalg.det(matrix[:3, :3]) < 0:
                mirrored.add(number)
            # The list of nodes may move in memory: what was taken from it is not used after this.
            state.nodes.append(copied)
            state.nodes[0].props[f"_arg_copy_{number}"] = mi.Properties.ResolvedReference(number)
        del state.nodes[0].props[key]
    for key in groups:
        del state.nodes[0].props[key]
    return frozenset(mirrored)


def matrix_of(props: Any) -> NDArray[np.float64]:
    """[4, 4] of the transform of a shape; Mitsuba refuses properties of other types."""
    return np.array(getattr(props.get("to_world", None), "matrix", np.eye(4)), np.float64)


def referred(props: Any) -> dict[str, int]:
    """Indices of the nodes that a node refers to, by the names of the properties."""
    kind = load_mitsuba().Properties.Type.ResolvedReference
    return {key: props[key].index() for key in list(props.keys()) if props.type(key) == kind}
