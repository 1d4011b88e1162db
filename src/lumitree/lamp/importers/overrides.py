"""Settings that replace or complete a model's file: materials, emission, unit, up axis.

They are read from a TOML file, see docs/bring-your-own-lamp.md. Error messages contain the name of
the file and the key.
"""

import dataclasses
import math
import warnings
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

import numpy as np

from lumitree.asset import materials as surfaces
from lumitree.asset.geometry import Medium
from lumitree.asset.materials import CONDUCTORS, Image, Texture, places_on_image, transmits
from lumitree.core.arguments import UNITS
from lumitree.core.frames import similarity
from lumitree.core.photometry import (
    MAX_TEMPERATURE,
    MIN_TEMPERATURE,
    RGB,
    blackbody_colour,
    radiance_from_flux,
)
from lumitree.core.tables import Range, converted, read_toml
from lumitree.errors import LumitreeError, LumitreeWarning, shown, shown_names
from lumitree.lamp.importers.topology import count_solids
from lumitree.lamp.materials import WHITE, Material, Value, glass, metal
from lumitree.lamp.meshes import Floats, Mesh, area_normals, join
from lumitree.lamp.parts import Geometry, Part, select_names


@dataclasses.dataclass(frozen=True)
class Emission:
    """Emission of a material: radiance, W/(m² sr), or the luminous flux of all its surfaces.

    Only the ratios of the flux's `colour`, linear RGB, matter.
    """

    radiance: RGB | None
    lumens: float = 0.0
    colour: RGB = WHITE


@dataclasses.dataclass(frozen=True)
class MaterialOverride:
    """Replacements of parts of a material; None keeps what the file says.

    With `guess_thin` the surface is glass, and the file does not state whether it is thin. `medium`
    fills the surface.
    """

    surface: surfaces.Material | None = None
    medium: Medium | None = None
    guess_thin: bool = False
    emission: Emission | None = None
    opacity: float | None = None


@dataclasses.dataclass(frozen=True)
class Overrides:
    """A file of overrides; `up` is the model's upward axis, `variant` a glTF material variant."""

    file: str = ""
    metres_per_unit: float = 1.0
    up: Literal["y", "z"] = "y"
    variant: str | None = None
    materials: Mapping[str, MaterialOverride] = dataclasses.field(default_factory=dict)

    def of(self, material: Material) -> MaterialOverride | None:
        """The override of a material, by its name in the model's file or its own."""
        return self.materials.get(material.title, self.materials.get(material.name))


def setting(title: str, value: str) -> str:
    """The line of a file of overrides that gives a material a value, for messages."""
    name = shown(title).replace("\\", "\\\\").replace('"', '\\"')
    return f'material."{name}".{value}'


def apply_overrides(model: Geometry, overrides: Overrides) -> Geometry:
    """The model in metres, y up, with its materials changed; unknown materials are refused."""
    changes: dict[str, MaterialOverride] = {}
    for name, change in overrides.materials.items():
        titles = {item.title for item in model.materials if name in (item.title, item.name)}
        if not titles:
            known = dict.fromkeys(item.title for item in model.materials)
            raise LumitreeError(
                f"{overrides.file}: no material is called {shown(name)!r}; the model has "
                f"{shown_names(known)}"
            )
        changes |= dict.fromkeys(titles, change)
    model = _in_metres(model, overrides)
    materials = [
        _resurfaced(model, each, changes[each.title]) if each.title in changes else each
        for each in model.materials
    ]
    # A flux is emitted by the surfaces as they are now, where they are present.
    model = dataclasses.replace(model, materials=tuple(materials))
    for at, each in enumerate(materials):
        change = changes.get(each.title)
        if change is not None and change.emission is not None:
            radiance = _radiance(model, each.title, change.emission, overrides.file)
            materials[at] = dataclasses.replace(each, radiance=radiance)
    return dataclasses.replace(model, materials=tuple(materials))


def sided_materials(model: Geometry, overrides: Overrides) -> set[str]:
    """Titles of materials whose front and back differ once the overrides are applied.

    Those that emit, and those that reflect on one side only.
    """
    found = set()
    for each in model.materials:
        change = overrides.of(each)
        emits, alike = each.radiance is not None, each.two_sided or transmits(each.surface)
        if change is not None:
            emits, alike = emits or change.emission is not None, alike or change.surface is not None
        if emits or not alike:
            found.add(each.title)
    return found


def select_parts(model: Geometry, keep: Sequence[str], drop: Sequence[str], file: str) -> Geometry:
    """The parts that match a `keep` pattern and no `drop` pattern (* and ?); no `keep` keeps all.

    Patterns match the name of a part, its object or its material. A part with several copies keeps
    the copies whose objects match. A pattern without a match, or an empty selection, is refused.
    """
    objects = {name for part in model.parts for name in part.objects}
    copies = [(part, at) for part in model.parts for at in range(len(part.places))]
    names = []
    for part, at in copies:
        choices = [part.objects[at]] if part.objects else []
        # Also the name of a part of an object of another name.
        choices += [] if part.name in objects else [part.name]
        names.append(tuple(dict.fromkeys([*choices, model.material(part).title, part.material])))
    chosen = select_names(names, keep, drop, file, "part or material")
    kept: dict[str, list[int]] = {}
    for (part, at), wanted in zip(copies, chosen, strict=True):
        if wanted:
            kept.setdefault(part.name, []).append(at)
    parts = tuple(part.copies(kept[part.name]) for part in model.parts if part.name in kept)
    return dataclasses.replace(model, parts=parts)


def check_emits(model: Geometry, file: str, overrides_name: str) -> None:
    """Refuse a model that does not emit; the message names the TOML file of overrides to write."""
    used = {part.material for part in model.parts}
    if not any(
        item.radiance is not None and item.opacity != 0
        for item in model.materials
        if item.name in used
    ):
        known = list(dict.fromkeys(i.title for i in model.materials if i.name in used))
        light = "emitter = { lumens = 800, temperature = 2700 }"
        raise LumitreeError(
            f"{file} has no emitter (materials: {shown_names(known)}); name one in "
            f"{overrides_name}: {setting(known[0] if known else 'bulb', light)}"
        )


def emitting_area(model: Geometry, title: str) -> float:
    """Area of all surfaces with a material of the file, times their opacity, in square units.

    Every copy counts.
    """
    total = 0.0
    for part in _parts_with(model, title):
        opacity = opacity_of_faces(model.material(part).opacity, part.mesh, model.images)
        normals = opacity[:, None] * area_normals(part.mesh.vertices, part.mesh.faces)
        for place in part.places:
            linear = place[:3, :3]
            # Area vectors are transformed by the matrix of cofactors.
            cofactors = np.linalg.det(linear) * np.linalg.inv(linear)
            total += float(np.linalg.norm(normals @ cofactors, axis=1).sum()) / 2
    return total


def opacity_of_faces(opacity: Value, mesh: Mesh, images: Sequence[Image] = ()) -> Floats:
    """Mean opacity [F] of the faces of a mesh."""
    count = len(mesh.faces)
    if not isinstance(opacity, Texture):
        return np.full(count, float(opacity))
    if mesh.uv is None:
        return np.full(count, float(_looked_up(opacity, images, np.zeros((1, 2)))[0]))
    points = _points_of_triangle(math.isqrt(_POINTS // max(count, 1)))
    uv = np.einsum("pc,fcx->pfx", points, mesh.uv[mesh.faces])
    values = _looked_up(opacity, images, uv.reshape(-1, 2))
    return values.reshape(len(points), count).mean(axis=0)


def _points_of_triangle(parts: int) -> Floats:
    """Barycentric coordinates [N, 3] of the middles of the equal parts of a triangle."""
    side = min(max(parts, 1), 128)
    i, j = (each.ravel() for each in np.meshgrid(np.arange(side), np.arange(side)))
    upright = np.stack([i, j], axis=1)[i + j < side] + 1 / 3
    turned = np.stack([i, j], axis=1)[i + j < side - 1] + 2 / 3
    two = np.concatenate([upright, turned]) / side
    return np.column_stack([two, 1 - two.sum(axis=1)])


def _looked_up(texture: Texture, images: Sequence[Image], uv: Floats) -> Floats:
    """Values [N] of the nearest pixels of a texture with one channel, in [0, 1]."""
    place, pixels = places_on_image(texture.to_uv, uv), images[texture.image]
    match texture.wrap_mode:
        case "repeat":
            place = place % 1.0
        case "mirror":
            place = 1 - np.abs(place % 2.0 - 1)
        case "clamp":
            pass
    height, width = pixels.shape[:2]
    column, row = (
        np.clip(np.floor(place[:, axis] * size), 0, size - 1).astype(np.int64)
        for axis, size in ((0, width), (1, height))
    )
    return pixels[row, column, 0] / 255.0


def _in_metres(model: Geometry, overrides: Overrides) -> Geometry:
    scale = overrides.metres_per_unit
    if scale == 1 and overrides.up == "y":
        return model
    upright = np.eye(3) if overrides.up == "y" else np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    matrix = similarity(upright, scale, np.zeros(3))
    unscaled = similarity(np.eye(3), 1 / scale, np.zeros(3))
    parts = []
    for part in model.parts:
        mesh = unscaled if part.in_metres else np.eye(4)
        places = tuple(matrix @ place @ mesh for place in part.places)
        parts.append(dataclasses.replace(part, places=places))
    materials = [
        each if each.medium is None else dataclasses.replace(each, medium=each.medium.scaled(scale))
        for each in model.materials
    ]
    return dataclasses.replace(model, parts=tuple(parts), materials=tuple(materials))


def _resurfaced(model: Geometry, material: Material, change: MaterialOverride) -> Material:
    if change.surface is not None:
        # Opacity and normal map belong to the surface that is replaced.
        material = Material(
            material.name,
            _settled(model, material.title, change, change.surface),
            material.radiance,
            two_sided=True,
            title=material.title,
            medium=change.medium,
        )
    if change.opacity is not None:
        material = dataclasses.replace(material, opacity=change.opacity)
    return material


def _settled(
    model: Geometry, title: str, change: MaterialOverride, surface: surfaces.Material
) -> surfaces.Material:
    """The surface; glass is a thin sheet if `guess_thin` is set and the meshes are not closed."""
    match surface:
        case surfaces.Dielectric() | surfaces.MetallicRoughness(spec_trans=1, thin=False):
            pass
        case _:
            return surface
    # A mesh is divided where its texture coordinates are mirrored: parts in one place are one.
    meshes: dict[bytes, list[Mesh]] = {}
    for part in _parts_with(model, title):
        meshes.setdefault(np.array(part.places).tobytes(), []).append(part.mesh)
    shares = [count_solids(join(each)) for each in meshes.values()]
    closed, pieces = (sum(column) for column in zip((0, 0), *shares, strict=True))
    if closed == pieces:
        return surface
    if not change.guess_thin:
        warnings.warn(
            f"material {shown(title)!r} is solid glass, but only {closed} of its {pieces} "
            "pieces are closed; light that enters the others never leaves the glass",
            LumitreeWarning,
            stacklevel=3,
        )
        return surface
    if closed:
        warnings.warn(
            f"material {shown(title)!r}: {closed} of {pieces} pieces are closed, the others are "
            "not; all are taken to be thin sheets; write thin = true or false",
            LumitreeWarning,
            stacklevel=3,
        )
    return surfaces.make_material(surfaces.ThinDielectric.plugin, surface.parameters)


def _parts_with(model: Geometry, title: str) -> list[Part]:
    return [part for part in model.parts if model.material(part).title == title]


def _radiance(model: Geometry, title: str, emission: Emission, file: str) -> RGB | None:
    if emission.radiance is not None:
        return emission.radiance if max(emission.radiance) > 0 else None
    if not _parts_with(model, title):
        # All parts with the material were dropped, or none has it: no surface emits the flux.
        return None
    area = emitting_area(model, title)
    if area <= 0:
        raise LumitreeError(f"{file}: material {shown(title)!r} has no area to emit lumens from")
    return radiance_from_flux(emission.lumens, area, emission.colour)


# Points at which the opacity of a mesh is looked up, about.
_POINTS = 1 << 18
_MAX_EMISSION = 1e9
_GREY: RGB = (0.5, 0.5, 0.5)
_Share: TypeAlias = Annotated[float, Range(0, 1)]
_Ior: TypeAlias = Annotated[float, Range(1, 4, above=True)]
_Positive: TypeAlias = Annotated[float, Range(0, _MAX_EMISSION)]
# R, G and B, or one number for all.
_Factors: TypeAlias = _Share | tuple[_Share, _Share, _Share]
_Radiance: TypeAlias = _Positive | tuple[_Positive, _Positive, _Positive]


@dataclasses.dataclass(frozen=True)
class _Glass:
    ior: _Ior = 1.5
    roughness: _Share = 0.0
    tint: _Factors = WHITE
    thin: bool | None = None
    absorption: _Radiance | None = None
    scattering: _Radiance | None = None
    anisotropy: Annotated[float, Range(-0.99, 0.99)] = 0.0


@dataclasses.dataclass(frozen=True)
class _Metal:
    tint: _Factors = WHITE
    roughness: _Share = 0.0
    conductor: str = "none"


@dataclasses.dataclass(frozen=True)
class _Diffuse:
    reflectance: _Factors = _GREY


@dataclasses.dataclass(frozen=True)
class _Principled:
    base_color: _Factors = _GREY
    metallic: _Share = 0.0
    roughness: _Share = 0.5
    ior: _Ior = 1.5
    clearcoat: _Share = 0.0
    transmission: _Share = 0.0
    diffuse_transmission: Annotated[float, Range(0, 2)] = 0.0
    thin: bool = False


@dataclasses.dataclass(frozen=True)
class _Emitter:
    radiance: _Radiance | None = None
    lumens: Annotated[float, Range(0, _MAX_EMISSION, above=True)] | None = None
    temperature: Annotated[float, Range(MIN_TEMPERATURE, MAX_TEMPERATURE)] | None = None


@dataclasses.dataclass(frozen=True)
class _Material:
    glass: _Glass | None = None
    metal: _Metal | None = None
    diffuse: _Diffuse | None = None
    principled: _Principled | None = None
    emitter: _Emitter | None = None
    opacity: _Share | None = None


@dataclasses.dataclass(frozen=True)
class _File:
    units: str | Annotated[float, Range(1e-6, 1e6)] = 1.0
    up: Literal["y", "z"] = "y"
    variant: str | None = None
    material: dict[str, Any] = dataclasses.field(default_factory=dict)


def read_overrides(path: Path) -> Overrides:
    """Read a TOML file of overrides."""
    file = converted(read_toml(path, "a TOML file of overrides"), _File, path)
    materials = {}
    for name, values in file.material.items():
        table = f"material.{shown(name)}"
        material = converted(values, _Material, path, table)
        try:
            materials[name] = _override(material, table)
        except LumitreeError as error:
            raise LumitreeError(f"{shown(path, 300)}: {error}") from None
    if isinstance(file.units, str) and file.units not in UNITS:
        raise LumitreeError(
            f"{shown(path, 300)}: units is {shown(file.units)!r}; expected one of "
            f"{', '.join(UNITS)}, or the metres in a unit"
        )
    return Overrides(
        file=str(path),
        metres_per_unit=UNITS[file.units] if isinstance(file.units, str) else file.units,
        up=file.up,
        variant=file.variant,
        materials=materials,
    )


def _override(material: _Material, name: str) -> MaterialOverride:
    members = (material.glass, material.metal, material.diffuse, material.principled)
    read = [each for each in members if each is not None]
    if len(read) > 1:
        raise LumitreeError(f"{name} has {len(read)} surfaces; expected one")
    change = MaterialOverride(opacity=material.opacity)
    if read:
        change = dataclasses.replace(_surface(read[0], name), opacity=material.opacity)
    if material.emitter is None:
        return change
    return dataclasses.replace(change, emission=_emission(material.emitter, f"{name}.emitter"))


def _surface(read: _Glass | _Metal | _Diffuse | _Principled, name: str) -> MaterialOverride:
    match read:
        case _Glass():
            return _glass(read, f"{name}.glass")
        case _Metal() if read.conductor not in CONDUCTORS:
            raise LumitreeError(
                f"{name}.metal.conductor is {shown(read.conductor)!r}; expected Ag, Al, Au, Cr, "
                "Cu, W or another of Mitsuba's, or none"
            )
        case _Metal():
            return MaterialOverride(metal(_rgb(read.tint), read.roughness, read.conductor))
        case _Diffuse():
            return MaterialOverride(surfaces.Diffuse(reflectance=_rgb(read.reflectance)))
        case _Principled():
            surface = surfaces.MetallicRoughness(
                base_color=_rgb(read.base_color),
                metallic=read.metallic,
                roughness=read.roughness,
                eta=read.ior,
                clearcoat=read.clearcoat,
                spec_trans=read.transmission,
                diff_trans=read.diffuse_transmission,
                thin=read.thin,
            )
            return MaterialOverride(surface)


def _glass(read: _Glass, name: str) -> MaterialOverride:
    solid = read.roughness > 0 or read.absorption is not None or read.scattering is not None
    if read.thin and solid:
        raise LumitreeError(
            f"{name} is thin; a thin sheet has no roughness, absorption or scattering: use tint, "
            "or thin = false"
        )
    medium = Medium(_rgb(read.absorption or 0.0), _rgb(read.scattering or 0.0), read.anisotropy)
    return MaterialOverride(
        glass(read.ior, read.roughness, _rgb(read.tint), thin=bool(read.thin)),
        medium if any(medium.absorption + medium.scattering) else None,
        guess_thin=read.thin is None and not solid,
    )


def _emission(read: _Emitter, name: str) -> Emission:
    if (read.radiance is None) == (read.lumens is None):
        raise LumitreeError(f"{name} needs either radiance or lumens")
    colour = WHITE if read.temperature is None else blackbody_colour(read.temperature)
    if read.radiance is None:
        return Emission(None, read.lumens or 0.0, colour)
    radiance = _rgb(read.radiance)
    if read.temperature is not None and len(set(radiance)) > 1:
        raise LumitreeError(f"{name} has a temperature, so its radiance has to be one number")
    red, green, blue = (factor * channel for factor, channel in zip(radiance, colour, strict=True))
    return Emission((red, green, blue))


def _rgb(value: float | tuple[float, float, float]) -> RGB:
    return value if isinstance(value, tuple) else (value, value, value)
