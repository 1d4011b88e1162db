"""Settings that replace or complete a model's file: materials, emission, unit, up axis."""

import dataclasses
import warnings
from collections.abc import Mapping, Sequence
from typing import Literal

import numpy as np

from lumitree.core.frames import similarity
from lumitree.core.photometry import radiance_from_flux
from lumitree.errors import LumitreeError, LumitreeWarning, shown, shown_names
from lumitree.lamp.importers.topology import count_solids
from lumitree.lamp.masked_emission import opacity_of_faces
from lumitree.lamp.meshes import Floats, Mesh, area_normals, join
from lumitree.lamp.names import select_names
from lumitree.lamp.parts import RGB, WHITE, Geometry, Glass, Material, Part, Surface
from lumitree.lamp.scene_writer import transmits


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

    With `guess_thin` the surface is glass, and the file does not state whether it is thin.
    """

    surface: Surface | None = None
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
    own = [(each, changes.get(each.title, MaterialOverride())) for each in model.materials]
    materials = tuple(_resurfaced(model, each, change) for each, change in own)
    # A flux is emitted by what is present of the surfaces as they are now.
    model = dataclasses.replace(model, materials=materials)
    materials = tuple(
        _lit(model, each, change, overrides.file)
        for each, (_, change) in zip(materials, own, strict=True)
    )
    return dataclasses.replace(model, materials=materials)


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
    titles = {material.name: material.title for material in model.materials}
    objects = {name for part in model.parts for name in part.objects}
    copies = [(part, at) for part in model.parts for at in range(len(part.places))]
    names = []
    for part, at in copies:
        own = [part.objects[at]] if part.objects else []
        # Also the name of a part of an object of another name.
        own += [] if part.name in objects else [part.name]
        names.append(tuple(dict.fromkeys([*own, titles[part.material], part.material])))
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
    total, materials = 0.0, {material.name: material for material in model.materials}
    for part in _parts_with(model, title):
        opacity = opacity_of_faces(materials[part.material].opacity, part.mesh)
        normals = opacity[:, None] * area_normals(part.mesh.vertices, part.mesh.faces)
        for place in part.places:
            linear = place[:3, :3]
            # Area vectors are transformed by the matrix of cofactors.
            cofactors = np.linalg.det(linear) * np.linalg.inv(linear)
            total += float(np.linalg.norm(normals @ cofactors, axis=1).sum()) / 2
    return total


def _in_metres(model: Geometry, overrides: Overrides) -> Geometry:
    scale = overrides.metres_per_unit
    if scale == 1 and overrides.up == "y":
        return model
    upright = np.eye(3) if overrides.up == "y" else np.array([[1, 0, 0], [0, 0, 1], [0, -1, 0]])
    matrix = np.eye(4)
    matrix[:3, :3] = scale * upright
    return Geometry(
        tuple(_moved(part, matrix, scale) for part in model.parts),
        tuple(_rescaled(material, scale) for material in model.materials),
    )


def _moved(part: Part, matrix: Floats, scale: float) -> Part:
    """The part in a model that a similarity of this scale has changed."""
    places = [matrix @ place for place in part.places]
    if part.in_metres:
        own = similarity(np.eye(3), 1 / scale, np.zeros(3))
        places = [place @ own for place in places]
    return dataclasses.replace(part, places=tuple(places))


def _rescaled(material: Material, scale: float) -> Material:
    """The material in a model `scale` times as large: coefficients of media are per length."""
    glass = material.surface
    if not isinstance(glass, Glass) or glass.medium is None:
        return material
    medium = dataclasses.replace(
        glass.medium,
        absorption=_divided(glass.medium.absorption, scale),
        scattering=_divided(glass.medium.scattering, scale),
    )
    return dataclasses.replace(material, surface=dataclasses.replace(glass, medium=medium))


def _divided(colour: RGB, divisor: float) -> RGB:
    return (colour[0] / divisor, colour[1] / divisor, colour[2] / divisor)


def _resurfaced(model: Geometry, material: Material, change: MaterialOverride) -> Material:
    """The material with the surface and the opacity of an override."""
    if change.surface is not None:
        # Opacity and normal map belong to the surface that is replaced.
        material = Material(
            material.name,
            _settled(model, material.title, change),
            material.radiance,
            two_sided=not isinstance(change.surface, Glass),
            title=material.title,
        )
    if change.opacity is not None:
        material = dataclasses.replace(material, opacity=change.opacity)
    return material


def _lit(model: Geometry, material: Material, change: MaterialOverride, file: str) -> Material:
    """The material with the emission of an override."""
    if change.emission is None:
        return material
    radiance = _radiance(model, material.title, change.emission, file)
    return dataclasses.replace(material, radiance=radiance)


def _settled(model: Geometry, title: str, change: MaterialOverride) -> Surface:
    """The surface; glass is a thin sheet if `guess_thin` is set and the meshes are not closed."""
    surface = change.surface
    assert surface is not None
    if not isinstance(surface, Glass) or surface.thin:
        return surface
    shares = [count_solids(mesh) for mesh in _whole_meshes(_parts_with(model, title))]
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
    return dataclasses.replace(surface, thin=True)


def _whole_meshes(parts: Sequence[Part]) -> list[Mesh]:
    """Meshes of parts, of which those in one place count as one.

    A mesh is divided where its texture coordinates are mirrored.
    """
    meshes: dict[bytes, list[Mesh]] = {}
    for part in parts:
        meshes.setdefault(np.array(part.places).tobytes(), []).append(part.mesh)
    return [join(each) for each in meshes.values()]


def _parts_with(model: Geometry, title: str) -> list[Part]:
    """The parts with a material of the file."""
    names = {material.name for material in model.materials if material.title == title}
    return [part for part in model.parts if part.material in names]


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
