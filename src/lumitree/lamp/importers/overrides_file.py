"""The TOML file of overrides; docs/bring-your-own-lamp.md describes it.

Error messages contain the name of the file and the key.
"""

import dataclasses
from pathlib import Path
from typing import Annotated, Any, Literal, TypeAlias

from lumitree.asset.materials import CONDUCTORS
from lumitree.core.photometry import MAX_TEMPERATURE, MIN_TEMPERATURE, blackbody_colour
from lumitree.core.toml_file import Range, converted, read_toml
from lumitree.core.units import UNITS
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.importers.overrides import Emission, MaterialOverride, Overrides
from lumitree.lamp.parts import (
    RGB,
    WHITE,
    Diffuse,
    Glass,
    Medium,
    Metal,
    Principled,
    Surface,
)

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
    surfaces = [
        each
        for each in (material.glass, material.metal, material.diffuse, material.principled)
        if each is not None
    ]
    if len(surfaces) > 1:
        raise LumitreeError(f"{name} has {len(surfaces)} surfaces; expected one")
    emission = None
    if material.emitter is not None:
        emission = _emission(material.emitter, f"{name}.emitter")
    surface, guess_thin = None, False
    if surfaces:
        surface, guess_thin = _surface(surfaces[0], name)
    return MaterialOverride(surface, guess_thin, emission, material.opacity)


def _surface(read: _Glass | _Metal | _Diffuse | _Principled, name: str) -> tuple[Surface, bool]:
    """The surface, and whether the file leaves open whether it is thin."""
    if isinstance(read, _Glass):
        return _glass(read, f"{name}.glass")
    if isinstance(read, _Metal):
        if read.conductor not in CONDUCTORS:
            raise LumitreeError(
                f"{name}.metal.conductor is {shown(read.conductor)!r}; expected Ag, Al, Au, Cr, "
                "Cu, W or another of Mitsuba's, or none"
            )
        return Metal(_rgb(read.tint), read.roughness, read.conductor), False
    if isinstance(read, _Diffuse):
        return Diffuse(_rgb(read.reflectance)), False
    return Principled(**{**vars(read), "base_color": _rgb(read.base_color)}), False


def _glass(read: _Glass, name: str) -> tuple[Surface, bool]:
    solid = read.roughness > 0 or read.absorption is not None or read.scattering is not None
    if read.thin and solid:
        raise LumitreeError(
            f"{name} is thin; a thin sheet has no roughness, absorption or scattering: use tint, "
            "or thin = false"
        )
    glass = Glass(
        ior=read.ior, roughness=read.roughness, tint=_rgb(read.tint), thin=bool(read.thin)
    )
    medium = Medium(_rgb(read.absorption or 0.0), _rgb(read.scattering or 0.0), read.anisotropy)
    if any(medium.absorption + medium.scattering):
        glass = dataclasses.replace(glass, medium=medium)
    return glass, read.thin is None and not solid


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
