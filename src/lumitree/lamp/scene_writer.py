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

from lumitree.asset.materials import Conductor
from lumitree.core.backend import load_mitsuba, second_thread
from lumitree.core.files import accepts_name, atomic_path
from lumitree.core.frames import is_far, similarity
from lumitree.core.mitsuba_meshes import VERTEX_COLOUR, make_mesh
from lumitree.lamp.conductors import normal_reflectance
from lumitree.lamp.masked_emission import MaskedEmission
from lumitree.lamp.meshes import Floats, Mesh
from lumitree.lamp.metallic_roughness import METALLIC_ROUGHNESS, register_metallic_roughness
from lumitree.lamp.names import Names
from lumitree.lamp.parts import (
    WHITE,
    Colour,
    Diffuse,
    Geometry,
    Glass,
    Material,
    Medium,
    Metal,
    Part,
    Principled,
    Surface,
    Texture,
    Value,
    VertexColour,
)
from lumitree.lamp.scene_shapes import SceneShape

SCENE_FILE = "luminaire.xml"
# Prefix of the ids of materials.
_PREFIX = "material_"
# Roughness below which a surface is smooth: the geometry of an asset has no smaller alpha than its
# square.
_SMOOTH = 0.01


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
        # A texture that several materials share is written once.
        self._textures: dict[int, str] = {}
        emission, used = MaskedEmission(), {part.material for part in self._model.parts}
        self._emitted = {name: emission.of(self._materials[name]) for name in sorted(used)}

    def write(self) -> Path:
        root = Element("scene", version="3.0.0")
        for name in self._emitted:
            self._bsdf(root, self._materials[name])
        # Shapes and materials share one namespace. Parts in one place keep their names.
        ids, single = Names("_"), [part for part in self._model.parts if len(part.places) == 1]
        for name in self._emitted:
            ids.unique(_reference(self._materials[name]))
        own = {part.name: ids.unique(part.name) for part in single}
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
                name = own.get(part.name) or ids.unique(f"{part.name}_{copy + 1}")
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
        if isinstance(material.surface, Glass) and material.surface.medium is not None:
            _medium(shape, material.surface.medium)
        radiance = self._emitted[part.material]
        if radiance is not None:
            emitter = SubElement(shape, "emitter", type="area")
            self._colour(emitter, "radiance", radiance)

    def _bsdf(self, root: Element, material: Material) -> None:
        """The material's layers, outermost first: mask, two-sidedness, normals, surface."""
        parent, name = root, {"id": _reference(material)}
        if not (isinstance(material.opacity, float | int) and material.opacity == 1):
            parent, name = SubElement(parent, "bsdf", {"type": "mask", **name}), {}
            self._value(parent, "opacity", material.opacity)
        if material.two_sided and not transmits(material.surface):
            parent, name = SubElement(parent, "bsdf", {"type": "twosided", **name}), {}
        if material.normal_map is not None:
            parent, name = SubElement(parent, "bsdf", {"type": "normalmap", **name}), {}
            self._texture(parent, "normalmap", material.normal_map)
        self._surface(parent, material.surface, name)

    def _surface(self, parent: Element, surface: Surface, name: dict[str, str]) -> None:
        match surface:
            case Glass():
                self._glass(parent, surface, name)
            case Metal():
                self._metal(parent, surface, name)
            case Diffuse():
                bsdf = SubElement(parent, "bsdf", {"type": "diffuse", **name})
                self._colour(bsdf, "reflectance", surface.reflectance)
            case Principled():
                self._principled(parent, surface, name)

    def _metal(self, parent: Element, metal: Metal, name: dict[str, str]) -> None:
        rough = metal.roughness >= _SMOOTH
        if rough and metal.microfacets == "ggx":
            reflectance = normal_reflectance(Conductor(material=metal.conductor))
            colour = tuple((np.array(metal.tint) * reflectance).tolist())
            surface = Principled(colour, metallic=1.0, roughness=metal.roughness)
            self._principled(parent, surface, name)
            return
        kind = "roughconductor" if rough else "conductor"
        bsdf = SubElement(parent, "bsdf", {"type": kind, **name})
        _add(bsdf, "string", "material", metal.conductor)
        if rough:
            _rough(bsdf, metal)
        _rgb(bsdf, "specular_reflectance", metal.tint)

    def _glass(self, parent: Element, glass: Glass, name: dict[str, str]) -> None:
        rough = glass.roughness >= _SMOOTH and not glass.thin
        if rough and glass.microfacets == "ggx":
            red, green, blue = (channel**2 for channel in glass.tint)
            surface = Principled(
                (red, green, blue), roughness=glass.roughness, ior=glass.ior, transmission=1.0
            )
            self._principled(parent, surface, name)
            return
        kind = "thindielectric" if glass.thin else "roughdielectric" if rough else "dielectric"
        bsdf = SubElement(parent, "bsdf", {"type": kind, **name})
        _add(bsdf, "float", "int_ior", _number(glass.ior))
        _add(bsdf, "float", "ext_ior", "1")
        if rough:
            _rough(bsdf, glass)
        if glass.tint != WHITE:
            _rgb(bsdf, "specular_transmittance", glass.tint)

    def _principled(self, parent: Element, surface: Principled, name: dict[str, str]) -> None:
        bsdf = SubElement(parent, "bsdf", {"type": METALLIC_ROUGHNESS, **name})
        self._colour(bsdf, "base_color", surface.base_color)
        self._value(bsdf, "metallic", surface.metallic)
        self._value(bsdf, "roughness", surface.roughness)
        self._value(bsdf, "anisotropic", surface.anisotropy)
        self._value(bsdf, "eta", surface.ior)
        self._value(bsdf, "specular", surface.specular)
        self._value(bsdf, "sheen", surface.sheen)
        self._value(bsdf, "clearcoat", surface.clearcoat)
        self._value(bsdf, "clearcoat_roughness", surface.clearcoat_roughness)
        self._value(bsdf, "spec_trans", surface.transmission)
        self._value(bsdf, "diff_trans", surface.diffuse_transmission)
        _add(bsdf, "boolean", "thin", "true" if surface.thin else "false")

    def _colour(self, parent: Element, name: str, colour: Colour) -> None:
        match colour:
            case Texture():
                self._texture(parent, name, colour)
            case VertexColour():
                texture = SubElement(parent, "texture", type="mesh_attribute", name=name)
                _add(texture, "string", "name", VERTEX_COLOUR)
            case _:
                _rgb(parent, name, colour)

    def _value(self, parent: Element, name: str, value: Value) -> None:
        if isinstance(value, Texture):
            self._texture(parent, name, value)
        else:
            _add(parent, "float", name, _number(value))

    def _texture(self, parent: Element, name: str, texture: Texture) -> None:
        element = SubElement(parent, "texture", type="bitmap", name=name)
        _add(element, "string", "filename", self._image(texture))
        _add(element, "boolean", "raw", "false" if texture.encoded else "true")
        _add(element, "string", "wrap_mode", texture.wrap)
        _add(element, "string", "filter_type", "nearest" if texture.nearest else "bilinear")
        # Mitsuba reads the affine map from the upper 2 x 2 block and the last column.
        matrix = np.eye(4)
        matrix[:2, :2], matrix[:2, 3] = texture.uv_transform[:2, :2], texture.uv_transform[:2, 2]
        _transform(element, "to_uv", matrix)

    def _image(self, texture: Texture) -> str:
        """File of the texture's pixels, written at the first use."""
        mi = load_mitsuba()
        key = id(texture.pixels)
        if key not in self._textures:
            kind = "png" if texture.pixels.dtype == np.uint8 else "exr"
            name = f"textures/{len(self._textures):03d}.{kind}"
            bitmap = mi.Bitmap(np.ascontiguousarray(texture.pixels))
            bitmap.set_srgb_gamma(kind == "png" and texture.encoded)
            with atomic_path(self._folder / name) as temporary, second_thread():
                bitmap.write(str(temporary))
            self._textures[key] = name
        return self._textures[key]


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
        own = np.array(list(itertools.product(*boxes[id(part.mesh)].T)))
        for place in part.places:
            corners.append(own @ place[:3, :3].T + place[:3, 3])
            scale = np.linalg.norm(place[:3, :3], axis=0).max()
            reach.append(float(np.abs(own).max() * scale))
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


def transmits(surface: Surface) -> bool:
    """Whether light crosses a surface, so that its BSDF defines both sides."""
    if isinstance(surface, Principled):
        diffuse = surface.thin and surface.diffuse_transmission > 0
        return diffuse or isinstance(surface.transmission, Texture) or surface.transmission > 0
    return isinstance(surface, Glass)


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


def _rough(bsdf: Element, surface: Glass | Metal) -> None:
    _add(bsdf, "string", "distribution", surface.microfacets)
    _add(bsdf, "float", "alpha", _number(surface.roughness**2))


def _add(parent: Element, kind: str, name: str, value: str) -> None:
    SubElement(parent, kind, name=name, value=value)


def _number(value: float) -> str:
    return f"{value:.9g}"
