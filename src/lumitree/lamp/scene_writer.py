"""Writing of a model as a Mitsuba 3 scene, which is then loaded like a scene of the user."""

import dataclasses
import itertools
import math
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from xml.etree import ElementTree
from xml.etree.ElementTree import Element, SubElement

import numpy as np
from numpy.typing import NDArray

from lumitree.asset import materials as asset_materials
from lumitree.asset.geometry import Medium
from lumitree.asset.materials import VertexColours
from lumitree.core.backend import load_mitsuba, second_thread
from lumitree.core.files import accepts_name, atomic_path
from lumitree.core.frames import is_far, similarity
from lumitree.core.images import resized
from lumitree.core.mitsuba_meshes import VERTEX_COLOUR, make_mesh
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.meshes import Floats, Mesh
from lumitree.lamp.parts import (
    RGB,
    WHITE,
    Colour,
    Diffuse,
    Geometry,
    Glass,
    Material,
    Metal,
    MetallicRoughness,
    Names,
    Part,
    Surface,
    Texture,
    Value,
    transmits,
)
from lumitree.lamp.scene_file import register_metallic_roughness
from lumitree.lamp.scene_shapes import SceneShape

# For all products of one model.
_MAX_BYTES = 5 * 2**28
SCENE_FILE = "luminaire.xml"
# Prefix of the ids of materials.
_PREFIX = "material_"
# Roughness below which a surface is smooth: the geometry of an asset has no smaller alpha than its
# square.
_SMOOTH = 0.01
# Parameters of the BSDF that are a number or a texture, and the attributes of `MetallicRoughness`.
_PARAMETERS = {
    **{name: name for name in ("metallic", "roughness")},
    "anisotropic": "anisotropy",
    "eta": "ior",
    **{name: name for name in ("specular", "sheen", "clearcoat", "clearcoat_roughness")},
    "spec_trans": "transmission",
    "diff_trans": "diffuse_transmission",
}


class MaskedEmission:
    """Radiance times opacity of the materials of a model; equal products are made once.

    Mitsuba's emitters also emit where a mask lets light through.
    """

    def __init__(self) -> None:
        self._made: dict[tuple[int | RGB, int | float], NDArray[np.float32]] = {}

    def of(self, material: Material) -> Colour | None:
        """Emission of a material; None for nothing.

        If the texture coordinates of the opacity differ from the radiance's, its mean is used,
        after a warning.
        """
        radiance, opacity = material.radiance, material.opacity
        if radiance is None or (not isinstance(opacity, Texture) and opacity == 0):
            return None
        if isinstance(radiance, VertexColours) or opacity == 1:
            return radiance
        if not isinstance(radiance, Texture):
            if isinstance(opacity, Texture):
                return self._product(radiance, opacity, opacity, material.title)
            red, green, blue = (float(opacity * value) for value in radiance)
            return (red, green, blue)
        if isinstance(opacity, Texture) and not (
            np.array_equal(radiance.uv_transform, opacity.uv_transform)
            and radiance.wrap == opacity.wrap
        ):
            warnings.warn(
                f"material {shown(material.title)!r}: its opacity has other texture coordinates "
                "than its emission, which is multiplied by the mean of the opacity",
                LumitreeWarning,
                stacklevel=2,
            )
            opacity = float(opacity.pixels.mean() / 255)
        return self._product(radiance, opacity, radiance, material.title)

    def _product(
        self, radiance: RGB | Texture, opacity: Value, placed: Texture, title: str
    ) -> Texture:
        """A texture with the coordinates of `placed`."""
        key = (
            id(radiance.pixels) if isinstance(radiance, Texture) else radiance,
            id(opacity.pixels) if isinstance(opacity, Texture) else opacity,
        )
        if key not in self._made:
            factors = [
                each.linear() if isinstance(each, Texture) else np.reshape(each, (1, 1, -1))
                for each in (radiance, opacity)
            ]
            height, width = (max(each.shape[axis] for each in factors) for axis in (0, 1))
            size = sum(each.nbytes for each in self._made.values()) + 12 * height * width
            if size > _MAX_BYTES:
                raise LumitreeError(
                    f"material {shown(title)!r}: emission times opacity brings such images to "
                    f"{size >> 20} MiB; at most {_MAX_BYTES >> 20} MiB: make them smaller"
                )
            light, share = (
                each if each.shape[:2] == (1, 1) else resized(each, height, width)
                for each in factors
            )
            self._made[key] = (light * share).astype(np.float32)
        return dataclasses.replace(placed, pixels=self._made[key], encoded=False)


def normal_reflectance(metal: asset_materials.Metal) -> list[float]:
    """Reflectance [3] of a conductor at normal incidence, by Fresnel's equations."""
    mi = load_mitsuba()
    given = {"material": metal.material, "eta": metal.eta, "k": metal.k}
    images = asset_materials.Texture | VertexColours
    if any(isinstance(value, images) for value in given.values()):
        return [1.0, 1.0, 1.0]
    colours = {
        name: {"type": "rgb", "value": list(value)} if isinstance(value, tuple) else value
        for name, value in given.items()
        if value is not None
    }
    parameters = mi.traverse(mi.load_dict({"type": "conductor", **colours}))
    eta, k = (
        np.broadcast_to(np.array(parameters[f"{name}.value"], np.float64).ravel(), 3)
        for name in ("eta", "k")
    )
    return (((eta - 1) ** 2 + k**2) / ((eta + 1) ** 2 + k**2)).tolist()


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
            case MetallicRoughness():
                self._metallic_roughness(parent, surface, name)

    def _metal(self, parent: Element, metal: Metal, name: dict[str, str]) -> None:
        rough = metal.roughness >= _SMOOTH
        if rough and metal.microfacets == "ggx":
            reflectance = normal_reflectance(asset_materials.Conductor(material=metal.conductor))
            colour = tuple((np.array(metal.tint) * reflectance).tolist())
            surface = MetallicRoughness(colour, metallic=1.0, roughness=metal.roughness)
            self._metallic_roughness(parent, surface, name)
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
            surface = MetallicRoughness(
                (red, green, blue), roughness=glass.roughness, ior=glass.ior, transmission=1.0
            )
            self._metallic_roughness(parent, surface, name)
            return
        kind = "thindielectric" if glass.thin else "roughdielectric" if rough else "dielectric"
        bsdf = SubElement(parent, "bsdf", {"type": kind, **name})
        _add(bsdf, "float", "int_ior", _number(glass.ior))
        _add(bsdf, "float", "ext_ior", "1")
        if rough:
            _rough(bsdf, glass)
        if glass.tint != WHITE:
            _rgb(bsdf, "specular_transmittance", glass.tint)

    def _metallic_roughness(
        self, parent: Element, surface: MetallicRoughness, name: dict[str, str]
    ) -> None:
        bsdf = SubElement(
            parent, "bsdf", {"type": asset_materials.MetallicRoughness.plugin, **name}
        )
        self._colour(bsdf, "base_color", surface.base_color)
        for parameter, attribute in _PARAMETERS.items():
            self._value(bsdf, parameter, getattr(surface, attribute))
        _add(bsdf, "boolean", "thin", "true" if surface.thin else "false")

    def _colour(self, parent: Element, name: str, colour: Colour) -> None:
        match colour:
            case Texture():
                self._texture(parent, name, colour)
            case VertexColours():
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


def _rough(bsdf: Element, surface: Glass | Metal) -> None:
    _add(bsdf, "string", "distribution", surface.microfacets)
    _add(bsdf, "float", "alpha", _number(surface.roughness**2))


def _add(parent: Element, kind: str, name: str, value: str) -> None:
    SubElement(parent, kind, name=name, value=value)


def _number(value: float) -> str:
    return f"{value:.9g}"
