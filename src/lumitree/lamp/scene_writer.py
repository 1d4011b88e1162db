"""Writing of a model as a Mitsuba 3 scene, which is then loaded like a scene of the user."""

import dataclasses
import itertools
import math
import os
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np

from lumitree.asset import materials as surfaces
from lumitree.asset.geometry import Medium
from lumitree.asset.materials import Parameter, Texture, VertexColours
from lumitree.core.backend import load_mitsuba, second_thread
from lumitree.core.files import accepts_name, atomic_path
from lumitree.core.frames import is_far, similarity
from lumitree.core.mitsuba_meshes import VERTEX_COLOUR, make_mesh
from lumitree.lamp.materials import MaskedEmission, Material
from lumitree.lamp.meshes import Floats, Mesh
from lumitree.lamp.parts import Geometry, Names, Part
from lumitree.lamp.scene_file import register_metallic_roughness
from lumitree.lamp.scene_shapes import SceneShape

SCENE_FILE = "luminaire.xml"
# Prefix of the ids of materials.
_PREFIX = "material_"


def write_scene(model: Geometry, folder: str | os.PathLike[str]) -> Path:
    """Write `luminaire.xml`, `meshes/` and `textures/`; equal models give equal bytes.

    Copies of a part share one mesh file.

    Returns:
        Path of the scene file. It has shapes, BSDFs, interior media and area emitters, but no
        sensor and no integrator.

    Raises:
        LumitreeError: the folder cannot be written.
    """
    # The scene can then be loaded.
    register_metallic_roughness()
    return _Writer(model, Path(folder)).write()


class _Writer:
    def __init__(self, model: Geometry, folder: Path) -> None:
        self._far = _is_far(model)
        self._model, self._folder = _recentred(model) if self._far else model, folder
        self._materials = {material.name: material for material in model.materials}
        self._images = list(model.images)
        # Files by the index of their image: one that several textures share is written once.
        self._files: dict[int, str] = {}
        emission, used = MaskedEmission(self._images), {part.material for part in model.parts}
        self._emitted = {name: emission.of(self._materials[name]) for name in sorted(used)}

    def write(self) -> Path:
        root = Element("scene", version="3.0.0")
        for name in self._emitted:
            material = self._materials[name]
            self._material(root, material.bsdf, id=_reference(material))
        # Shapes and materials share one namespace. Parts in one place keep their names.
        ids, single = Names("_"), [part for part in self._model.parts if len(part.places) == 1]
        for name in self._emitted:
            ids.unique(_reference(self._materials[name]))
        names = {part.name: ids.unique(part.name) for part in single}
        for part in self._model.parts:
            # Such as con, which is a device of Windows.
            sign = "" if accepts_name(part.name) else "="
            mesh_file = f"meshes/{sign}{part.name}.ply"
            mesh = part.mesh
            if mesh.uv is None and isinstance(self._emitted[part.material], Texture):
                # Mitsuba takes masks at (0, 0) there, but has no such emitters.
                mesh = dataclasses.replace(mesh, uv=np.zeros((len(mesh.vertices), 2)))
            _write_mesh(self._folder / mesh_file, mesh)
            for copy in range(len(part.places)):
                name = names.get(part.name) or ids.unique(f"{part.name}_{copy + 1}")
                self._shape(root, part, copy, name, mesh_file)
        ElementTree.indent(root, "    ")
        path = self._folder / SCENE_FILE
        with atomic_path(path) as temporary:
            text = ElementTree.tostring(root, encoding="unicode") + "\n"
            temporary.write_text(text, encoding="utf-8", newline="\n")
        return path

    def _shape(self, root: Element, part: Part, copy: int, name: str, mesh_file: str) -> None:
        material = self._materials[part.material]
        shape = SubElement(root, "shape", type="ply", id=name)
        _add(shape, "string", "filename", mesh_file)
        _transform(shape, "to_world", part.places[copy], exact=self._far)
        SubElement(shape, "ref", id=_reference(material))
        if material.medium is not None:
            _medium(shape, material.medium)
        radiance = self._emitted[part.material]
        if radiance is not None:
            emitter = SubElement(shape, "emitter", type="area")
            self._parameter(emitter, "radiance", radiance)

    def _material(self, parent: Element, material: surfaces.Material, **attributes: str) -> None:
        bsdf = SubElement(parent, "bsdf", {"type": material.plugin, **attributes})
        # Factors of the light are last: the bytes of a scene identify a lamp.
        for name, value in sorted(
            material.parameters.items(), key=lambda item: item[0].startswith("specular_")
        ):
            self._parameter(bsdf, name, value)
        for nested in material.nested:
            self._material(bsdf, nested)

    def _parameter(self, parent: Element, name: str, value: Parameter) -> None:
        match value:
            case Texture():
                self._texture(parent, name, value)
            case VertexColours():
                texture = SubElement(parent, "texture", type="mesh_attribute", name=name)
                _add(texture, "string", "name", VERTEX_COLOUR)
            case tuple():
                _rgb(parent, name, value)
            case str():
                _add(parent, "string", name, value)
            case bool():
                _add(parent, "boolean", name, _flag(value))
            case _:
                _add(parent, "float", name, _number(value))

    def _texture(self, parent: Element, name: str, texture: Texture) -> None:
        element = SubElement(parent, "texture", type="bitmap", name=name)
        _add(element, "string", "filename", self._image(texture))
        _add(element, "boolean", "raw", _flag(texture.raw))
        _add(element, "string", "wrap_mode", texture.wrap_mode)
        _add(element, "string", "filter_type", texture.filter_type)
        _transform(element, "to_uv", np.array(texture.to_uv))

    def _image(self, texture: Texture) -> str:
        mi, index = load_mitsuba(), texture.image
        if index not in self._files:
            pixels = self._images[index]
            kind = "png" if pixels.dtype == np.uint8 else "exr"
            name = f"textures/{len(self._files):03d}.{kind}"
            bitmap = mi.Bitmap(np.ascontiguousarray(pixels))
            bitmap.set_srgb_gamma(kind == "png" and not texture.raw)
            with atomic_path(self._folder / name) as temporary, second_thread():
                bitmap.write(str(temporary))
            self._files[index] = name
        return self._files[index]


def model_shapes(shapes: Sequence[SceneShape]) -> tuple[SceneShape, ...]:
    """The shapes of a scene that `write_scene` wrote, with the names that the model has."""
    return tuple(
        dataclasses.replace(
            shape,
            number=None,
            materials=tuple(name.removeprefix(_PREFIX) for name in shape.materials),
        )
        for shape in shapes
    )


def _is_far(model: Geometry) -> bool:
    """Whether coordinates of the model, or of a mesh in its frame, are too coarse in float32."""
    boxes = {id(part.mesh): _box(part.mesh) for part in model.parts}
    corners, reach = [np.zeros((0, 3))], [0.0]
    for part in model.parts:
        box = np.array(list(itertools.product(*boxes[id(part.mesh)].T)))
        for place in part.places:
            corners.append(box @ place[:3, :3].T + place[:3, 3])
            scale = np.linalg.norm(place[:3, :3], axis=0).max()
            reach.append(float(np.abs(box).max() * scale))
    points = np.concatenate(corners)
    return is_far([np.abs(points).max(initial=0.0), *reach], np.ptp(points, axis=0).max())


def _box(mesh: Mesh) -> Floats:
    """[2, 3] smallest and largest coordinates."""
    return np.stack([mesh.vertices.min(axis=0), mesh.vertices.max(axis=0)])


def _recentred(model: Geometry) -> Geometry:
    """The model with the centre of each mesh in the origin of its own frame."""
    parts = []
    for part in model.parts:
        centre = _box(part.mesh).mean(axis=0)
        mesh = dataclasses.replace(part.mesh, vertices=part.mesh.vertices - centre)
        shift = similarity(np.eye(3), 1.0, centre)
        places = tuple(place @ shift for place in part.places)
        parts.append(dataclasses.replace(part, mesh=mesh, places=places))
    return dataclasses.replace(model, parts=tuple(parts))


def _reference(material: Material) -> str:
    # In a scene, ids of shapes and materials share one namespace, and $ begins a parameter.
    return _PREFIX + material.name.replace("$", "%24")


def _medium(shape: Element, medium: Medium) -> None:
    absorption, scattering = np.array(medium.absorption), np.array(medium.scattering)
    extinction = absorption + scattering
    # Mitsuba refuses an <rgb> above 1, so the magnitude is in the scale.
    scale = float(extinction.max())
    element = SubElement(shape, "medium", type="homogeneous", name="interior")
    _rgb(element, "sigma_t", tuple(extinction / scale))
    _rgb(element, "albedo", tuple(scattering / np.maximum(extinction, 1e-30)))
    _add(element, "float", "scale", _number(scale))
    if medium.anisotropy != 0:
        phase = SubElement(element, "phase", type="hg")
        _add(phase, "float", "g", _number(medium.anisotropy))


def _write_mesh(path: Path, mesh: Mesh) -> None:
    load_mitsuba()
    arrays = {
        "vertices": _rounded(mesh.vertices, 9),
        "faces": mesh.faces,
        "normals": _rounded(mesh.normals, 6),
        "texcoords": mesh.uv,
        "colours": mesh.colours,
    }
    written = make_mesh(path.stem, arrays)
    with atomic_path(path) as temporary:
        written.write_ply(str(temporary))


def _rounded(values: Floats, decimals: int) -> np.ndarray:
    """Rounded values, with 0 for -0: files do not depend on the rounding errors of a machine."""
    return (values.round(decimals) + 0.0).astype(np.float32)


def _transform(parent: Element, name: str, matrix: Floats, *, exact: bool = False) -> None:
    """A matrix of 9 digits; or of all, where 9 are too few for large coordinates."""
    transform = SubElement(parent, "transform", name=name)
    # For example of meshes with integer coordinates, whose unit is tiny.
    largest = float(np.abs(matrix[:3, :3]).max())
    decimals = 9 if largest >= 1e-3 or largest == 0 else 9 - math.floor(math.log10(largest))
    numbers = (matrix.round(decimals) + 0.0).ravel().tolist()
    values = " ".join(repr(value) if exact else f"{value:.9g}" for value in numbers)
    SubElement(transform, "matrix", value=values)


def _rgb(parent: Element, name: str, colour: tuple[float, ...]) -> None:
    _add(parent, "rgb", name, ", ".join(_number(channel) for channel in colour))


def _add(parent: Element, kind: str, name: str, value: str) -> None:
    SubElement(parent, kind, name=name, value=value)


def _number(value: float) -> str:
    return f"{value:.9g}"


def _flag(value: bool) -> str:
    return "true" if value else "false"
