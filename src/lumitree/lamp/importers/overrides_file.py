"""The TOML file of overrides; docs/bring-your-own-lamp.md describes it.

Error messages contain the name of the file and the key.
"""

import dataclasses
from collections.abc import Callable
from pathlib import Path
from typing import Any, Literal

from lumitree.asset.materials import CONDUCTORS
from lumitree.core.photometry import MAX_TEMPERATURE, MIN_TEMPERATURE, blackbody_colour
from lumitree.core.toml_table import (
    Table,
    UnexpectedError,
    boolean,
    dictionary,
    is_number,
    number,
    read_toml,
    shown_value,
    text,
)
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


def read_overrides(path: Path) -> Overrides:
    """Read a TOML file of overrides."""
    top = read_toml(path, "a TOML file of overrides")
    materials = top.take("material", dictionary("[material.NAME] tables")) or {}
    result = Overrides(
        file=str(path),
        metres_per_unit=top.take("units", _units) or 1.0,
        up=top.take("up", _up) or "y",
        variant=top.take("variant", text),
        materials={
            name: _material(Table(path, shown(f"material.{name}"), _as_table(path, name, value)))
            for name, value in materials.items()
        },
    )
    top.finish()
    return result


def _as_table(path: Path, name: str, value: Any) -> dict[str, Any]:
    if not isinstance(value, dict):
        raise LumitreeError(
            f"{shown(path, 300)}: material.{shown(name)} is {shown_value(value)}; expected a table"
        )
    return value


def _material(table: Table) -> MaterialOverride:
    readers = {
        "glass": _glass,
        "metal": _metal,
        "diffuse": _diffuse,
        "principled": _principled,
    }
    surfaces: list[tuple[Surface, bool]] = []
    for key, read in readers.items():
        own = table.table(key)
        if own is not None:
            surfaces.append(read(own))
            own.finish()
    if len(surfaces) > 1:
        table.fail(f"{table.name} has {len(surfaces)} surfaces; expected one")
    light = table.table("emitter")
    emission = None
    if light is not None:
        emission = _emission(light)
        light.finish()
    opacity = table.take("opacity", number(0.0, 1.0))
    table.finish()
    surface, guess_thin = surfaces[0] if surfaces else (None, False)
    return MaterialOverride(surface, guess_thin, emission, opacity)


def _glass(table: Table) -> tuple[Surface, bool]:
    thin = table.take("thin", boolean)
    glass = Glass(
        ior=table.take("ior", number(1.0, 4.0, open_low=True)) or 1.5,
        roughness=table.take("roughness", number(0.0, 1.0)) or 0.0,
        tint=table.take("tint", _rgb(1.0)) or WHITE,
        thin=bool(thin),
    )
    absorption = table.take("absorption", _rgb(_MAX_EMISSION))
    scattering = table.take("scattering", _rgb(_MAX_EMISSION))
    anisotropy = table.take("anisotropy", number(-0.99, 0.99)) or 0.0
    solid_only = glass.roughness > 0 or absorption is not None or scattering is not None
    if thin and solid_only:
        table.fail(
            f"{table.name} is thin; a thin sheet has no roughness, absorption or scattering: use "
            "tint, or thin = false"
        )
    extinction = [*(absorption or ()), *(scattering or ())]
    if any(extinction):
        black = (0.0, 0.0, 0.0)
        medium = Medium(absorption or black, scattering or black, anisotropy)
        glass = dataclasses.replace(glass, medium=medium)
    return glass, thin is None and not solid_only


def _metal(table: Table) -> tuple[Surface, bool]:
    return (
        Metal(
            tint=table.take("tint", _rgb(1.0)) or WHITE,
            roughness=_or(table.take("roughness", number(0.0, 1.0)), 0.0),
            conductor=table.take("conductor", _conductor) or "none",
        ),
        False,
    )


def _diffuse(table: Table) -> tuple[Surface, bool]:
    return Diffuse(table.take("reflectance", _rgb(1.0)) or (0.5, 0.5, 0.5)), False


def _principled(table: Table) -> tuple[Surface, bool]:
    share = number(0.0, 1.0)
    return (
        Principled(
            base_color=table.take("base_color", _rgb(1.0)) or (0.5, 0.5, 0.5),
            metallic=_or(table.take("metallic", share), 0.0),
            roughness=_or(table.take("roughness", share), 0.5),
            ior=table.take("ior", number(1.0, 4.0, open_low=True)) or 1.5,
            clearcoat=_or(table.take("clearcoat", share), 0.0),
            transmission=_or(table.take("transmission", share), 0.0),
            diffuse_transmission=_or(table.take("diffuse_transmission", number(0.0, 2.0)), 0.0),
            thin=bool(table.take("thin", boolean)),
        ),
        False,
    )


def _emission(table: Table) -> Emission:
    radiance = table.take("radiance", _rgb(_MAX_EMISSION))
    lumens = table.take("lumens", number(0.0, _MAX_EMISSION, open_low=True))
    temperature = table.take("temperature", number(MIN_TEMPERATURE, MAX_TEMPERATURE))
    if (radiance is None) == (lumens is None):
        table.fail(f"{table.name} needs either radiance or lumens")
    colour = WHITE if temperature is None else blackbody_colour(temperature)
    if radiance is None:
        return Emission(None, lumens or 0.0, colour)
    if temperature is not None and len(set(radiance)) > 1:
        table.fail(f"{table.name} has a temperature, so its radiance has to be one number")
    red, green, blue = (factor * channel for factor, channel in zip(radiance, colour, strict=True))
    return Emission((red, green, blue))


def _or(value: float | None, default: float) -> float:
    return default if value is None else value


def _rgb(high: float) -> Callable[[Any], RGB]:
    def read(value: Any) -> RGB:
        channels = value if isinstance(value, list) else [value] * 3
        if len(channels) != 3 or not all(
            is_number(channel) and 0 <= channel <= high for channel in channels
        ):
            raise UnexpectedError(f"[R, G, B] or one number, each from 0 to {high:g}")
        return (float(channels[0]), float(channels[1]), float(channels[2]))

    return read


def _units(value: Any) -> float:
    if isinstance(value, str) and value in UNITS:
        return UNITS[value]
    if not is_number(value) or not 1e-6 <= value <= 1e6:
        raise UnexpectedError(f"one of {', '.join(UNITS)}, or the metres in a unit")
    return float(value)


def _up(value: Any) -> Literal["y", "z"]:
    if value not in ("y", "z"):
        raise UnexpectedError("'y' or 'z'")
    return value


def _conductor(value: Any) -> str:
    if not isinstance(value, str) or value not in CONDUCTORS:
        raise UnexpectedError("Ag, Al, Au, Cr, Cu, W or another of Mitsuba's, or none")
    return value
