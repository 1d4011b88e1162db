"""The node tree of a glTF scene."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike

from lumitree.lamp.importers.gltf.container import Document
from lumitree.lamp.importers.gltf.item import MAX_MAGNITUDE, Item
from lumitree.lamp.meshes import Floats

MAX_DEPTH = 256
_IDENTITY = tuple(np.eye(4).ravel().tolist())


@dataclasses.dataclass(frozen=True)
class Node:
    """A node of the scene; `world` is `world_from_node` [4, 4]."""

    item: Item
    world: Floats


def scene_nodes(document: Document) -> list[Node]:
    """Every node of the default scene, parents before children.

    The default scene is the one the file names, else its first, else all root nodes. Nodes must
    form a forest of limited depth.
    """
    parents = _parents(document)
    pending = [(root, np.eye(4), 0) for root in reversed(_roots(document, parents))]
    nodes = []
    while pending:
        index, above, depth = pending.pop()
        item = document.entry("nodes", index)
        if depth > MAX_DEPTH:
            raise item.error(f"is nested more than {MAX_DEPTH} deep")
        world = above @ _local(item)
        if np.abs(world).max() > MAX_MAGNITUDE:
            raise item.error(f"is scaled or moved beyond {MAX_MAGNITUDE:g}")
        nodes.append(Node(item, world))
        pending += [(child, world, depth + 1) for child in reversed(item.indices("children"))]
    return nodes


def _parents(document: Document) -> dict[int, int]:
    parents: dict[int, int] = {}
    for index, node in enumerate(document.root.items("nodes")):
        for child in node.indices("children"):
            if child in parents:
                raise node.error(f"has child {child}, which already has another parent")
            parents[child] = index
    return parents


def _roots(document: Document, parents: dict[int, int]) -> list[int]:
    if "scene" not in document.root and not document.root.items("scenes"):
        return [i for i in range(len(document.root.items("nodes"))) if i not in parents]
    scene = document.entry("scenes", document.root.integer("scene", 0))
    roots = scene.indices("nodes")
    if len(set(roots)) < len(roots):
        raise scene.error("lists a node twice")
    # A cycle is only reached through a node that has a parent.
    for root in roots:
        if root in parents:
            raise scene.error(f"lists node {root}, which is the child of another node")
    return roots


def _local(item: Item) -> Floats:
    if "matrix" in item:
        matrix = np.array(item.numbers("matrix", _IDENTITY)).reshape(4, 4).T
        if not np.array_equal(matrix[3], (0, 0, 0, 1)):
            raise item.error("has a matrix that is not affine")
        return matrix
    return transforms(
        item.numbers("translation", (0.0, 0.0, 0.0)),
        item.numbers("rotation", (0.0, 0.0, 0.0, 1.0)),
        item.numbers("scale", (1.0, 1.0, 1.0)),
        item,
    )[0]


def transforms(translation: ArrayLike, rotation: ArrayLike, scale: ArrayLike, item: Item) -> Floats:
    """Transforms [N, 4, 4] that scale, then rotate, then translate.

    Translation and scale are [N, 3], or [3] for all; rotations [N, 4] or [4], quaternions x, y, z
    and w of any length.
    """
    quaternion = np.atleast_2d(np.asarray(rotation, np.float64))
    x, y, z, w = quaternion.T
    length = np.sqrt(x * x + y * y + z * z + w * w)
    if not ((length > 0) & (length < np.inf)).all():
        raise item.error("has a rotation that is no unit quaternion")
    x, y, z, w = quaternion.T / length
    turn = np.array(
        [
            [1 - 2 * (y * y + z * z), 2 * (x * y - z * w), 2 * (x * z + y * w)],
            [2 * (x * y + z * w), 1 - 2 * (x * x + z * z), 2 * (y * z - x * w)],
            [2 * (x * z - y * w), 2 * (y * z + x * w), 1 - 2 * (x * x + y * y)],
        ]
    )
    scale, translation = np.atleast_2d(scale), np.atleast_2d(translation)
    count = max(map(len, (quaternion, scale, translation)))
    local = np.zeros((count, 4, 4))
    local[:, :3, :3] = turn.transpose(2, 0, 1) * scale[:, None]
    local[:, :3, 3] = translation
    local[:, 3, 3] = 1.0
    return local
