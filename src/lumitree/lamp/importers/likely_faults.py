"""Faults that exported models often have and do not show by themselves, each with what mends it."""

import dataclasses
import operator
import warnings
from collections.abc import Iterator

import numpy as np
from numpy.typing import ArrayLike

from lumitree.core.images import linear_from_srgb
from lumitree.core.photometry import LUMENS_PER_WATT
from lumitree.errors import LumitreeWarning, shown
from lumitree.lamp.importers.overrides import Overrides, setting
from lumitree.lamp.importers.topology import has_body, probes
from lumitree.lamp.meshes import Floats
from lumitree.lamp.parts import Colour, Diffuse, Geometry, Glass, Metal, Surface, Texture, Value


def warn_of_likely_faults(model: Geometry, overrides: Overrides, file: str, toml: str) -> None:
    """Warn of emission in other units than lights, and of solid glass that the file makes thin.

    Materials whose overrides already say it are left out. The model is without its overrides, which
    the warning says to write to `toml`.
    """
    for fault, line in (*_two_units(model, overrides), *_thin_bodies(model, overrides)):
        warnings.warn(
            f"{shown(file, 300)}: {fault}: put first into {shown(toml, 100)}: {line}",
            LumitreeWarning,
            stacklevel=3,
        )


def _two_units(model: Geometry, overrides: Overrides) -> Iterator[tuple[str, str]]:
    """Emission of surfaces beside lights in candela: Blender writes its W/(m² sr) as cd/m²."""
    used = {part.material: part.in_metres for part in model.parts}
    if not any(used.values()):
        return
    for material in model.materials:
        change = overrides.of(material)
        overridden = change is not None and change.emission is not None
        if used.get(material.name) is False and material.radiance is not None and not overridden:
            luminance = LUMENS_PER_WATT * _mean(material.radiance)
            yield (
                f"material {shown(material.title)!r} emits {luminance.max():.4g} cd/m² beside "
                "lights in candela; if Blender wrote this number as W/(m² sr), the surface is "
                f"{LUMENS_PER_WATT:g} times too dark beside them",
                setting(material.title, f"emitter = {{ radiance = {_toml(luminance)} }}"),
            )


def _thin_bodies(model: Geometry, overrides: Overrides) -> Iterator[tuple[str, str]]:
    """Closed bodies of glass that is thin for want of a volume, as Blender writes it."""
    materials = {material.name: material for material in model.materials}
    copies = [
        (part.name, at, materials[part.material].title, probes(_placed(part.mesh.vertices, place)))
        for part in model.parts
        for at, place in enumerate(part.places)
    ]
    told: set[str] = set()
    for part in model.parts:
        material = materials[part.material]
        title, solid, change = material.title, _as_solid(material.surface), overrides.of(material)
        overridden = change is not None and change.surface is not None
        if title in told or solid is None or overridden:
            continue
        vertices = _placed(part.mesh.vertices, part.places[0])
        alike, others = (
            [points for *copy, own, points in copies if copy != [part.name, 0] and keep(own, title)]
            for keep in (operator.eq, operator.ne)
        )
        if has_body(dataclasses.replace(part.mesh, vertices=vertices), alike, others):
            told.add(title)
            yield (
                f"material {shown(title)!r} is glass without a volume, a thin sheet in glTF, but "
                "its mesh is closed; if it is solid, or a wall with both sides",
                setting(title, solid),
            )


def _as_solid(surface: Surface) -> str | None:
    """TOML of the solid glass of which a file has thin sheets; None for other surfaces."""
    match surface:
        case Metal() | Diffuse():
            return None
        case Glass():
            colour, roughness, transmission = _mean(surface.tint), 0.0, 1.0
        case _:
            colour, roughness = _mean(surface.base_color), float(_mean(surface.roughness)[0])
            transmission = float(_mean(surface.transmission)[0])
    if not surface.thin or transmission == 0:
        return None
    shared = f"ior = {surface.ior:.4g}, roughness = {roughness:.4g}"
    if transmission < 1:
        own = f"base_color = {_toml(colour)}, transmission = {transmission:.4g}"
        return f"principled = {{ {shared}, {own} }}"
    # Light crosses both sides of a solid.
    return f"glass = {{ {shared}, tint = {_toml(np.sqrt(colour))}, thin = false }}"


def _mean(value: Colour | Value) -> Floats:
    """The channels of a colour or a value; of an image their means, of vertex colours white."""
    if isinstance(value, Texture):
        pixels = value.pixels / 255.0 if value.pixels.dtype == np.uint8 else value.pixels
        linear = linear_from_srgb(pixels) if value.encoded else pixels
        return linear.mean(axis=(0, 1), dtype=np.float64)
    return np.atleast_1d(np.array(value if isinstance(value, float | tuple) else 1.0, np.float64))


def _toml(colour: ArrayLike) -> str:
    """A colour; one number where its channels are equal."""
    channels = [f"{channel:.4g}" for channel in np.ravel(colour)]
    return channels[0] if len(set(channels)) == 1 else f"[{', '.join(channels)}]"


def _placed(vertices: Floats, place: Floats) -> Floats:
    return vertices @ place[:3, :3].T + place[:3, 3]
