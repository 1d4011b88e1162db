"""The geometry of a glTF file: arrays, the node tree with its instances, and triangles."""

import dataclasses

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.errors import shown, shown_names
from lumitree.lamp.importers.gltf_document import MAX_MAGNITUDE, Document, Item, Notes
from lumitree.lamp.meshes import Floats, Mesh, area_normals, facets, summed_at_vertices
from lumitree.lamp.parts import check_shapes

MAX_DECODED_BYTES = 2**30
# Largest number of elements of an accessor without data. They are zero, except for those that a
# sparse accessor replaces.
MAX_UNSTORED = 2**20
_COMPONENTS = {5120: "<i1", 5121: "<u1", 5122: "<i2", 5123: "<u2", 5125: "<u4", 5126: "<f4"}
_LENGTHS = {"SCALAR": 1, "VEC2": 2, "VEC3": 3, "VEC4": 4}
MAX_DEPTH = 256
_IDENTITY = tuple(np.eye(4).ravel().tolist())
# Attributes of an instance: components, and the value of an instance without it.
_ATTRIBUTES = {
    "TRANSLATION": (0.0, 0.0, 0.0),
    "ROTATION": (0.0, 0.0, 0.0, 1.0),
    "SCALE": (1.0, 1.0, 1.0),
}
MAX_TRIANGLES = 20_000_000
_TRIANGLES, _STRIP, _FAN = 4, 5, 6


class Accessors:
    """Decodes accessors, each once."""

    def __init__(self, document: Document) -> None:
        self._document = document
        self._decoded: dict[int, NDArray[np.generic]] = {}
        self._bytes = 0

    def floats(self, index: int, lengths: tuple[int, ...]) -> NDArray[np.float64]:
        """[count, L] finite numbers, with normalised integers mapped to [0, 1] or [-1, 1].

        L must be one of `lengths`.
        """
        item = self._document.entry("accessors", index)
        stored = self._array(index, item, lengths)
        values = stored.astype(np.float64)
        if not (np.abs(values) <= MAX_MAGNITUDE).all():
            raise item.error(f"holds values that are not finite, or beyond {MAX_MAGNITUDE:g}")
        if item.flag("normalized") and stored.dtype.kind in "iu":
            values = np.maximum(values / np.iinfo(np.dtype(stored.dtype).name).max, -1.0)
        return values

    def integers(self, index: int) -> NDArray[np.int64]:
        """[count] of an accessor of unsigned integers."""
        item = self._document.entry("accessors", index)
        stored = self._array(index, item, (1,))
        if stored.dtype.kind != "u":
            raise item.error("holds indices that are not unsigned integers")
        return stored[:, 0].astype(np.int64)

    def count(self, index: int) -> int:
        """Number of elements that an accessor states."""
        return self._document.entry("accessors", index).integer("count", low=1)

    def _array(self, index: int, item: Item, lengths: tuple[int, ...]) -> NDArray[np.generic]:
        kind = item.string("type", "none")
        if _LENGTHS.get(kind) not in lengths:
            raise item.error(f"is of type {shown(kind, 20)!r}; expected {lengths} components")
        if index not in self._decoded:
            self._decoded[index] = self._decode(item, _LENGTHS[kind])
        return self._decoded[index]

    def _decode(self, item: Item, length: int) -> NDArray[np.generic]:
        count = item.integer("count", low=1)
        dtype = _dtype(item)
        self._bytes += count * length * dtype.itemsize
        if self._bytes > MAX_DECODED_BYTES:
            raise item.error(
                f"claims {count} elements, which brings the model to {self._bytes} bytes of "
                f"geometry; at most {MAX_DECODED_BYTES}"
            )
        if (view := item.index("bufferView")) is not None:
            values = self._strided(item, view, dtype, count, length)
        elif count <= MAX_UNSTORED:
            values = np.zeros((count, length), dtype)
        else:
            raise item.error(
                f"has {count} elements and no data; at most {MAX_UNSTORED} may be left out"
            )
        if "sparse" in item:
            values = self._with_sparse(item.item("sparse"), values)
        return values

    def _strided(
        self, item: Item, view: int, dtype: np.dtype, count: int, length: int
    ) -> NDArray[np.generic]:
        data, stride = self._document.view(view)
        size = dtype.itemsize * length
        step = size if stride is None else stride
        if step < size:
            raise item.error(f"has elements of {size} bytes, {step} bytes apart")
        start = item.integer("byteOffset", 0)
        if start + step * (count - 1) + size > len(data):
            raise item.error(
                f"claims {count} elements of {size} bytes, but its buffer view has only "
                f"{max(len(data) - start, 0)} bytes"
            )
        return np.ndarray((count, length), dtype, data, start, (step, dtype.itemsize)).copy()

    def _with_sparse(self, sparse: Item, values: NDArray[np.generic]) -> NDArray[np.generic]:
        count = sparse.integer("count", low=1)
        if count > len(values):
            raise sparse.error(f"replaces {count} of {len(values)} elements")
        places, new = sparse.item("indices"), sparse.item("values")
        dtype = _dtype(places)
        at = self._strided(places, places.integer("bufferView"), dtype, count, 1)[:, 0]
        if dtype.kind != "u" or at.max() >= len(values):
            raise sparse.error(f"replaces elements that are not among {len(values)}")
        values[at.astype(np.int64)] = self._strided(
            new, new.integer("bufferView"), np.dtype(values.dtype), count, values.shape[1]
        )
        return values


def _dtype(item: Item) -> np.dtype:
    component = item.integer("componentType")
    if component not in _COMPONENTS:
        raise item.error(f"has componentType {component}; expected one of {sorted(_COMPONENTS)}")
    return np.dtype(_COMPONENTS[component])


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
    parents: dict[int, int] = {}
    for index, node in enumerate(document.root.items("nodes")):
        for child in node.indices("children"):
            if child in parents:
                raise node.error(f"has child {child}, which already has another parent")
            parents[child] = index
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


def read_triangles(accessors: Accessors, primitive: Item, uv_set: int) -> Mesh | None:
    """A primitive's triangles, with normals; None where it holds points, lines or nothing.

    Texture coordinates of the number `uv_set` are read; the mesh has none if they are missing.
    """
    attributes = primitive.item("attributes")
    mode = primitive.integer("mode", _TRIANGLES)
    if mode not in (_TRIANGLES, _STRIP, _FAN) or "POSITION" not in attributes:
        return None
    position = attributes.integer("POSITION")
    count = accessors.count(position)
    indexed = primitive.index("indices")
    corners = count if indexed is None else accessors.count(indexed)
    if corners > 3 * MAX_TRIANGLES:
        raise primitive.error(f"has {corners} corners; at most {3 * MAX_TRIANGLES} are read")
    positions = accessors.floats(position, (3,))
    order = np.arange(count) if indexed is None else accessors.integers(indexed)
    if order.max() >= count:
        raise primitive.error(f"uses vertex {order.max()} of {count}; its indices are damaged")
    faces = _faces(order, mode)
    # Triangles without area join parts of strips.
    faces = faces[(area_normals(positions, faces) != 0).any(axis=1)]
    if not len(faces):
        return None
    used, faces = np.unique(faces, return_inverse=True)
    faces = faces.reshape(-1, 3)

    def attribute(name: str, lengths: tuple[int, ...]) -> Floats | None:
        index = attributes.index(name)
        if index is None:
            return None
        values = accessors.floats(index, lengths)
        if len(values) != count:
            raise primitive.error(f"has {count} vertices, but {len(values)} of {name}")
        return values[used]

    colours = attribute("COLOR_0", (3, 4))
    mesh = Mesh(
        positions[used],
        np.zeros((len(used), 3)),
        faces,
        attribute(f"TEXCOORD_{uv_set}", (2,)),
        None if colours is None else np.clip(colours[:, :3], 0.0, 1.0),
    )
    normals = attribute("NORMAL", (3,))
    if normals is not None:
        return _with_normals(mesh, normals)
    # Every face has vertices and a normal of its own, as glTF asks where normals are missing.
    corners = mesh.faces.ravel()
    faceted = mesh.taken(corners, np.arange(len(corners)).reshape(-1, 3))
    return dataclasses.replace(faceted, normals=facets(mesh.vertices[mesh.faces]).normals)


def baked(mesh: Mesh, world: Floats) -> Mesh:
    """The mesh moved by an affine map [4, 4] of any invertible kind; faces keep their front."""
    linear = world[:3, :3]
    normals = mesh.normals @ np.linalg.inv(linear)
    normals /= np.linalg.norm(normals, axis=1, keepdims=True)
    faces = mesh.faces[:, ::-1] if np.linalg.det(linear) < 0 else mesh.faces
    vertices = mesh.vertices @ linear.T + world[:3, 3]
    return dataclasses.replace(mesh, vertices=vertices, normals=normals, faces=faces)


def _faces(order: NDArray[np.int64], mode: int) -> NDArray[np.int64]:
    if mode == _TRIANGLES:
        return order[: len(order) // 3 * 3].reshape(-1, 3)
    if len(order) < 3:
        return np.zeros((0, 3), np.int64)
    if mode == _FAN:
        first = np.full(len(order) - 2, order[0])
        return np.stack([order[1:-1], order[2:], first], axis=1)
    faces = np.stack([order[:-2], order[1:-1], order[2:]], axis=1)
    # Every other triangle of a strip runs the other way round.
    faces[1::2] = faces[1::2][:, [0, 2, 1]]
    return faces


def _with_normals(mesh: Mesh, normals: Floats) -> Mesh:
    """With unit normals; zero ones become the mean of the faces around the vertex."""
    lengths = np.linalg.norm(normals, axis=1)
    missing = lengths < 1e-6
    if missing.any():
        around = summed_at_vertices(mesh.vertices, mesh.faces)
        around[(around == 0).all(axis=1)] = (0.0, 1.0, 0.0)
        normals = np.where(missing[:, None], around, normals)
        lengths = np.linalg.norm(normals, axis=1)
    return dataclasses.replace(mesh, normals=normals / lengths[:, None])
