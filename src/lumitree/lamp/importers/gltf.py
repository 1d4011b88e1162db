"""Reading a lamp from a glTF 2.0 file.

Lengths are metres and y is up, as in every glTF file. Emissive factors times strengths are
luminances in cd/m², and intensities of lights are in cd; both are divided by 683 lm/W.
"""

import dataclasses
import os
import warnings
from collections.abc import Iterator
from typing import NamedTuple

import numpy as np

from lumitree.errors import LumitreeError, LumitreeWarning, shown, shown_names
from lumitree.lamp.importers.gltf_document import Document, Item, Notes
from lumitree.lamp.importers.gltf_lights import light_parts
from lumitree.lamp.importers.gltf_materials import Materials, Use, safe_name
from lumitree.lamp.importers.gltf_scene import (
    MAX_TRIANGLES,
    Accessors,
    Node,
    baked,
    instances,
    read_triangles,
    scene_nodes,
)
from lumitree.lamp.importers.topology import (
    Pieces,
    faces_to_turn,
    is_solid,
    reach,
    repeats,
    turned_with_normals,
    weld,
)
from lumitree.lamp.materials import Material
from lumitree.lamp.meshes import Floats, Mesh, by_handedness
from lumitree.lamp.parts import Geometry, Names, Part, check_shapes


class Variants:
    """Chooses the material of every primitive."""

    def __init__(self, document: Document, variant: str | None) -> None:
        self._index = None
        if variant is None:
            return
        extension = document.root.extension("KHR_materials_variants")
        entries = [] if extension is None else extension.items("variants")
        names = [entry.string("name", "") for entry in entries]
        if variant not in names:
            raise document.root.error(
                f"no material variant {shown(variant)!r}; there are: {shown_names(names)}"
            )
        self._index = names.index(variant)

    def material(self, primitive: Item) -> int | None:
        """Index of a primitive's material; None for the default material."""
        extension = primitive.extension("KHR_materials_variants")
        if self._index is not None and extension is not None:
            for mapping in extension.items("mappings"):
                if self._index in mapping.indices("variants"):
                    return mapping.integer("material")
        return primitive.index("material")


def read_gltf(path: str | os.PathLike[str], *, variant: str | None = None) -> Geometry:
    """A lamp from a `.gltf` or `.glb` file, with the materials of a variant, or its default ones.

    Approximations of what Mitsuba cannot represent give one LumitreeWarning for each material and
    one for the file. Nothing outside the file's folder is read.
    """
    document = Document(path)
    notes = Notes(document.name)
    model = _Reader(document, notes, variant).read()
    for line in notes.lines():
        warnings.warn(line, LumitreeWarning, stacklevel=2)
    return model


class _Copy(NamedTuple):
    """A place of a mesh, `world_from_mesh` [4, 4], and the name of the object there."""

    world: Floats
    object: str


class _Reader:
    def __init__(self, document: Document, notes: Notes, variant: str | None) -> None:
        self._document, self._notes = document, notes
        self._variants = Variants(document, variant)
        lights = document.root.extension("KHR_lights_punctual")
        self._lights = [] if lights is None else lights.items("lights")
        self._accessors = Accessors(document)
        self._part_names, self._material_names = Names("_"), Names("_")
        self._materials = Materials(document, notes, self._material_names)
        self._parts: list[Part] = []
        self._light_materials: list[Material] = []
        self._triangles = self._shapes = self._instances = 0

    def read(self) -> Geometry:
        if unknown := self._document.unknown_extensions:
            self._notes.file(f"extension {shown_names(unknown)}")
        if self._document.root.items("animations"):
            self._notes.file("animations (nodes stay where they are)")
        if len(self._document.root.items("scenes")) > 1:
            self._notes.file("scenes other than the default")
        meshes: dict[int, list[Node]] = {}
        lights: dict[int, list[Node]] = {}
        for node in scene_nodes(self._document):
            if "skin" in node.item:
                self._notes.file("skins (meshes stay in their rest pose)")
            if (mesh := node.item.index("mesh")) is not None:
                placed = instances(node, self._accessors, self._notes, self._instances)
                self._instances += len(placed)
                meshes.setdefault(mesh, []).extend(placed)
            elif node.item.extension("EXT_mesh_gpu_instancing") is not None:
                self._notes.file("instances of nodes without a mesh")
            if (light := node.item.extension("KHR_lights_punctual")) is not None:
                lights.setdefault(light.integer("light"), []).append(node)
        for index, nodes in lights.items():
            self._light(index, nodes)
        for index, nodes in meshes.items():
            self._mesh(index, nodes)
        if not self._parts:
            raise LumitreeError(f"{self._document.name} has no triangles in its scene")
        materials = (*self._materials.all, *self._light_materials)
        return Geometry(tuple(self._parts), materials, tuple(self._materials.images.pixels))

    def _light(self, index: int, nodes: list[Node]) -> None:
        item = nodes[0].item
        if index >= len(self._lights):
            raise item.error(f"names light {index}, but there are {len(self._lights)}")
        self._shapes += len(nodes)
        check_shapes(self._shapes, item.where)
        light = self._lights[index]
        default = light.string("name", str(index))
        name = self._part_names.unique(safe_name(f"light_{default}"))
        objects = tuple(node.item.string("name", default) for node in nodes)
        worlds = [node.world for node in nodes]
        for part, material in light_parts(light, worlds, name, self._notes, self._materials.images):
            title = self._material_names.unique(material.name)
            self._light_materials.append(dataclasses.replace(material, name=title))
            unique = name if part.name == name else self._part_names.unique(part.name)
            self._parts.append(
                dataclasses.replace(part, name=unique, material=title, objects=objects)
            )

    def _mesh(self, index: int, nodes: list[Node]) -> None:
        item = self._document.entry("meshes", index)
        if any(primitive.data.get("targets") for primitive in item.items("primitives")):
            self._notes.file("morph targets (meshes keep their base shape)")
        default, copies = item.string("name", f"mesh_{index}"), []
        for node in nodes:
            linear = node.world[:3, :3]
            if abs(np.linalg.det(linear)) <= 1e-12 * np.linalg.norm(linear) ** 3:
                self._notes.file("meshes that are scaled to nothing")
            else:
                copies.append(_Copy(node.world, node.item.string("name", default)))
        name = nodes[0].item.string("name", default)
        for primitive in item.items("primitives") if copies else []:
            self._primitive(primitive, name, copies)

    def _primitive(self, primitive: Item, name: str, copies: list[_Copy]) -> None:
        material = self._variants.material(primitive)
        layers = self._materials.layers(material)
        mesh = read_triangles(self._accessors, primitive, layers.uv_set)
        if mesh is None:
            self._notes.file("points, lines and empty meshes")
            return
        self._shapes += len(copies)
        check_shapes(self._shapes, primitive.where)
        self._triangles += len(mesh.faces) * len(copies)
        if self._triangles > MAX_TRIANGLES:
            raise primitive.error(
                f"brings the model to {self._triangles} triangles; at most {MAX_TRIANGLES} are read"
            )
        closed = self._materials.depends_on_closure(material) and is_solid(mesh)
        if closed and self._materials.solid(material):
            mesh = oriented_outwards(mesh, primitive.where)
        if layers.textured and mesh.uv is None:
            layers.note("textures on a mesh without texture coordinates (one point is used)")
            mesh = dataclasses.replace(mesh, uv=np.zeros((len(mesh.vertices), 2)))
        for placed, places, scale in _placed(mesh, copies):
            used = scale if self._materials.solid(material) else 1.0
            for piece, mirrored in by_handedness(placed, self._materials.bumpy(material)):
                use = Use(closed, mirrored, mesh.colours is not None, used)
                self._add(name, piece, places, material, use)

    def _add(self, name: str, mesh: Mesh, copies: list[_Copy], index: int | None, use: Use) -> None:
        material, factor = self._materials.read(index, use)
        colours = None if mesh.colours is None or factor is None else mesh.colours * factor
        part = Part(
            self._part_names.unique(safe_name(name)),
            dataclasses.replace(mesh, colours=colours),
            material.name,
            tuple(copy.world for copy in copies),
            tuple(copy.object for copy in copies),
        )
        self._parts.append(part)


def oriented_outwards(mesh: Mesh, where: str) -> Mesh:
    """A solid mesh with its faces and its normals oriented outwards; `where` is for a warning."""
    places = weld(mesh.vertices)
    _, representative = np.unique(places, return_index=True)
    # A repeated face is turned as the first in its place is.
    first, against = repeats(mesh.vertices[mesh.faces], reach(mesh.vertices))
    single = np.unique(first)
    faces = places[mesh.faces[single]]
    turn = np.zeros(len(first), np.bool_)
    turn[single] = faces_to_turn(mesh.vertices[representative], faces, Pieces(faces), where)
    return turned_with_normals(mesh, turn[first] ^ against)


def _placed(mesh: Mesh, copies: list[_Copy]) -> Iterator[tuple[Mesh, list[_Copy], float]]:
    """The mesh with its places and its scale; a copy of it where a place is no similarity."""
    shared: dict[float, list[_Copy]] = {}
    for copy in copies:
        linear = copy.world[:3, :3]
        determinant = float(np.linalg.det(linear))
        scale = abs(determinant) ** (1 / 3)
        if determinant > 0 and np.allclose(
            linear.T @ linear, scale**2 * np.eye(3), rtol=0, atol=1e-6 * scale**2
        ):
            shared.setdefault(float(f"{scale:.3g}"), []).append(copy)
        else:
            yield baked(mesh, copy.world), [_Copy(np.eye(4), copy.object)], scale
    for scale, alike in shared.items():
        yield mesh, alike, scale
