"""A luminaire as the geometry of an asset: its meshes and images as arrays, its BSDFs by name."""

from __future__ import annotations

import dataclasses
from collections import defaultdict
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.geometry import (
    ARRAYS,
    UNIT_SHAPES,
    AssetGeometry,
    MeshArrays,
    MeshShape,
    Shape,
    UnitShape,
)
from lumitree.asset.materials import (
    MAX_NESTING,
    Diffuse,
    Image,
    ImageFacts,
    Material,
    Parameter,
    Radiance,
    Texture,
    VertexColours,
    check_material,
    check_radiance,
    check_surface,
    make_material,
)
from lumitree.core.backend import load_mitsuba, second_thread
from lumitree.core.frames import rows_of
from lumitree.core.mitsuba_meshes import VERTEX_COLOUR, is_flipped, mesh_arrays
from lumitree.core.reading import Arrays, naming
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.media import stored_medium
from lumitree.lamp.meshes import area_normals
from lumitree.lamp.scene_file import SceneFile

if TYPE_CHECKING:
    import mitsuba as mi

# For all copies of instances; an asset has 36 bytes for each.
_MAX_PRIMITIVES = 20_000_000
_BITMAP = ("filename", "raw", "filter_type", "wrap_mode", "to_uv")


def stored_geometry(luminaire: Luminaire) -> AssetGeometry:
    """The geometry of a luminaire, for its asset.

    Meshes of one material and radiance are joined, which renders faster. Instances are copied.

    Raises:
        LumitreeError: the luminaire cannot be stored: it has a shape, BSDF, texture, emitter or
            medium that is not in the lists of `asset.materials`, its instances have too many
            triangles, or it was made from a mi.Scene. The message is the reason.
    """
    file, shapes = luminaire.parsed, luminaire.scene.shapes()
    if any(shape.class_name() == "Instance" for shape in shapes):
        count = sum(shape.effective_primitive_count() for shape in shapes)
        if count > _MAX_PRIMITIVES:
            raise LumitreeError(
                f"its instances have {count:,} triangles, expected at most {_MAX_PRIMITIVES:,}"
            )
        file = file.without_instances()
        shapes = file.instantiate().shapes()
    return _Reader(file).read(shapes, luminaire.origin)


class _Reader:
    """Reads the nodes of a scene file, and the shapes that were created of them."""

    def __init__(self, file: SceneFile) -> None:
        self._file = file
        self._images: list[Image] = []
        self._facts: list[ImageFacts] = []
        self._image_of: dict[tuple[Path, bool], int] = {}
        self._materials: list[Material] = []

    def read(self, shapes: list[mi.Shape], origin: NDArray[np.float64]) -> AssetGeometry:
        nodes = self._file.nodes("Shape")
        names = [shown(node.props.id() or node.props.plugin_name(), 60) for node in nodes]
        described = []
        for node, name in zip(nodes, names, strict=True):
            with naming(partial("shape {!r}".format, name)):
                described.append(self._describe(node.props))
        if len(shapes) != len(nodes):
            raise LumitreeError("a shape that becomes several, such as `merge`, is not stored")
        # Meshes that become one, by their properties and the names of their arrays.
        meshes: dict[str, list[tuple[Shape, MeshArrays]]] = defaultdict(list)
        others: list[Shape] = []
        for turned, node, name, shape, properties in zip(
            self._file.mirrored(), nodes, names, shapes, described, strict=True
        ):
            plugin = node.props.plugin_name()
            with naming(partial("shape {!r}".format, name)):
                sides = {"interior": shape.interior_medium(), "exterior": shape.exterior_medium()}
                media = {side: stored_medium(each) for side, each in sides.items() if each}
                properties = dataclasses.replace(properties, **media)
                mesh: MeshArrays = {}
                # A rectangle is a mesh to Mitsuba.
                if shape.is_mesh() and plugin not in UNIT_SHAPES:
                    mesh = mesh_arrays(shape)
                    properties = dataclasses.replace(properties, flipped=is_flipped(shape))
                    if turned:
                        _turn(mesh)
                material = self._materials[properties.material]
                check_surface(material, properties.radiance, mesh, self._facts)
                if mesh:
                    meshes[repr((plugin, properties, sorted(mesh)))].append((properties, mesh))
                else:
                    others.append(_unit_shape(plugin, shape, properties))
        return _joined(meshes, others, self._images, self._materials, origin)

    def _describe(self, props: mi.Properties) -> Shape:
        """Properties of a shape besides its form and its media."""
        radiance: Radiance | None = None
        material: Material | None = None
        for child in self._file.children(props).values():
            if child.type == load_mitsuba().ObjectType.Emitter:
                radiance = self._radiance(child.props)
            elif child.type == load_mitsuba().ObjectType.BSDF:
                material = self._material(child.props)
            elif child.type != load_mitsuba().ObjectType.Medium:
                raise LumitreeError(f"a {props.plugin_name()} holds an object that is not stored")
        if material is None:
            # As Mitsuba has it: what emits reflects nothing.
            material = Diffuse(reflectance=None if radiance is None else 0.0)
        check_material(material, self._facts)
        if material not in self._materials:
            self._materials.append(material)
        return Shape(
            material=self._materials.index(material),
            radiance=radiance,
            flipped=bool(props.get("flip_normals", False)),
        )

    def _radiance(self, props: mi.Properties) -> Radiance:
        if props.plugin_name() != "area":
            raise LumitreeError(f"an emitter {props.plugin_name()!r} is not stored; expected area")
        values, _ = self._values(props)
        if set(values) - {"radiance"}:
            raise LumitreeError("an area emitter has parameters that are not stored")
        radiance: Any = values.get("radiance", (1.0, 1.0, 1.0))
        check_radiance(radiance, self._facts)
        return radiance

    def _material(self, props: mi.Properties, nesting: int = 1) -> Material:
        # Refused here already: materials may share a nested one in very many ways.
        if nesting > MAX_NESTING:
            raise LumitreeError(f"materials are nested more than {MAX_NESTING} deep")
        values, nested = self._values(props, nesting)
        return make_material(props.plugin_name(), values, nested)

    def _values(
        self, props: mi.Properties, nesting: int = 1
    ) -> tuple[dict[str, Parameter], list[Material]]:
        """Parameters of a plugin, and its nested materials."""
        mi = load_mitsuba()
        values: dict[str, Parameter] = {}
        nested: list[Material] = []
        children = self._file.children(props)
        for name in list(props.keys()):
            child = children.get(name)
            if child is None:
                listed = props.type(name) == mi.Properties.Type.Spectrum
                values[name] = _colour(props, name) if listed else _plain(name, props[name])
            elif child.type == mi.ObjectType.Texture:
                # Mitsuba takes the texture of a bump map by any name.
                key = "bumpmap" if props.plugin_name() == "bumpmap" else name
                values[key] = self._texture(child.props)
            elif child.type == mi.ObjectType.BSDF:
                nested.append(self._material(child.props, nesting + 1))
            else:
                raise LumitreeError(f"{props.plugin_name()} holds an object that is not stored")
        return values, nested

    def _texture(self, props: mi.Properties) -> Texture | VertexColours:
        plugin = props.plugin_name()
        attribute = plugin == "mesh_attribute"
        if not attribute and (plugin != "bitmap" or "filename" not in props):
            raise LumitreeError(f"a texture {plugin!r} is not stored; expected bitmap")
        known = ("name",) if attribute else _BITMAP
        if unknown := sorted(set(props.keys()) - set(known)):
            raise LumitreeError(f"a {plugin} has a parameter {unknown[0]!r} that is not stored")
        if attribute:
            if (name := str(props.get("name", ""))) != VERTEX_COLOUR:
                raise LumitreeError(f"a mesh_attribute {name!r} is not stored")
            return VertexColours()
        raw = bool(props.get("raw", False))
        to_uv = props.get("to_uv", load_mitsuba().ScalarTransform4f())
        return Texture(
            image=self._image(self._file.resolve(props["filename"]), raw),
            raw=raw,
            filter_type=props.get("filter_type", "bilinear"),
            wrap_mode=props.get("wrap_mode", "repeat"),
            to_uv=rows_of(to_uv.matrix),
        )

    def _image(self, path: Path, raw: bool) -> int:
        """Index of the image of a file: 8 bits a channel as they are, others as linear numbers.

        Raw ones are numbers already, also where the file's are sRGB, as in PNG files.
        """
        mi = load_mitsuba()
        key = (path, raw)
        if key not in self._image_of:
            with second_thread():
                bitmap = mi.Bitmap(str(path))
            if bitmap.component_format() != mi.Struct.Type.UInt8:
                if raw:
                    bitmap.set_srgb_gamma(False)
                bitmap = bitmap.convert(component_format=mi.Struct.Type.Float32, srgb_gamma=False)
            pixels = np.array(bitmap)
            self._image_of[key] = len(self._images)
            self._images.append(pixels[..., None] if pixels.ndim == 2 else pixels)
            self._facts.append(ImageFacts.of(self._images[-1]))
        return self._image_of[key]


def _plain(name: str, value: object) -> Parameter:
    if isinstance(value, bool | int | float | str):
        return value
    numbers = np.ravel(np.array(value, np.float64))
    if numbers.shape != (3,):
        raise LumitreeError(f"a parameter {shown(name, 60)!r} of a BSDF is not stored")
    red, green, blue = numbers.tolist()
    return (red, green, blue)


def _colour(props: mi.Properties, name: str) -> Parameter:
    """A spectrum as the RGB, or the number, that RGB variants of Mitsuba take it for."""
    # Values that may exceed 1, and values that are light.
    if name == "radiance":
        texture = props.get_emissive_texture(name)
    elif name in ("eta", "k"):
        texture = props.get_unbounded_texture(name)
    else:
        texture = props.get_texture(name)
    value = np.ravel(np.array(load_mitsuba().traverse(texture)["value"], np.float64)).tolist()
    return (value[0], value[1], value[2]) if len(value) == 3 else value[0]


def _turn(mesh: MeshArrays) -> None:
    """Turn the faces of a mesh round, and its normals if Mitsuba has made them from the faces."""
    mesh["faces"] = mesh["faces"][:, ::-1]
    if "normals" in mesh:
        of_faces = area_normals(mesh["vertices"].astype(np.float64), mesh["faces"])
        of_vertices = mesh["normals"][mesh["faces"]].sum(axis=1)
        if (of_faces * of_vertices).sum() < 0:
            mesh["normals"] = -mesh["normals"]


def _unit_shape(plugin: str, shape: mi.Shape, properties: Shape) -> UnitShape:
    if plugin not in UNIT_SHAPES:
        raise LumitreeError(f"a {plugin} is not stored")
    to_world = rows_of(load_mitsuba().traverse(shape)["to_world"].matrix)
    if plugin == "disk":
        # Its matrix has the turned normal already.
        properties = dataclasses.replace(properties, flipped=False)
    return UnitShape(type=plugin, to_world=to_world, **vars(properties))


def _joined(
    meshes: dict[str, list[tuple[Shape, MeshArrays]]],
    others: list[Shape],
    images: list[Image],
    materials: list[Material],
    origin: NDArray[np.float64],
) -> AssetGeometry:
    shapes: list[Shape] = []
    arrays: dict[str, list[NDArray[np.generic]]] = {name: [] for name in ARRAYS}
    for group in meshes.values():
        properties, names = group[0][0], group[0][1].keys()
        first = 0
        for _, mesh in group:
            for name, values in mesh.items():
                offset = first if name == "faces" else 0
                arrays[name].append(values + np.asarray(offset, values.dtype))
            first += len(mesh["vertices"])
        shapes.append(
            MeshShape(
                vertices=first,
                faces=sum(len(mesh["faces"]) for _, mesh in group),
                **{name: name in names for name in ("normals", "texcoords", "colours")},
                **vars(properties),
            )
        )
    joined: Arrays = {
        name: np.concatenate([np.zeros((0, width), dtype), *arrays[name]])
        for name, (dtype, width) in ARRAYS.items()
    }
    return AssetGeometry(
        **joined,
        images=tuple(images),
        shapes=(*shapes, *others),
        materials=tuple(materials),
        origin=(float(origin[0]), float(origin[1]), float(origin[2])),
    )
