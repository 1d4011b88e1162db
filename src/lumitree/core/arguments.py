"""Checks of arguments, made before any work is done."""

import os
from collections.abc import Collection, Sequence
from pathlib import Path

import numpy as np
from numpy.typing import ArrayLike

from lumitree.core.files import check_writable
from lumitree.errors import LumitreeError, shown

# Largest image side, and paths or samples per pixel.
MAX_PIXELS_A_SIDE = 1 << 14
MAX_SAMPLES = 1 << 20
# Limits of a bake: rays, and seconds (one year).
MAX_RAYS, MAX_SECONDS = 1 << 50, 365 * 24 * 3600.0
# Largest factor on the light of a lamp.
MAX_GAIN = 1e6
# Limits of a luminous flux, lm, and of a colour temperature, K.
MIN_LUMENS, MAX_LUMENS = 1e-6, 1e9
MIN_KELVIN, MAX_KELVIN = 1000, 20000


def check_range(name: str, value: float, low: float, high: float, unit: str = "") -> None:
    """Refuse a value that is not a number in [low, high].

    Args:
        name: name of the option, for the message.
        unit: unit of the number, for the message.
    """
    number = isinstance(value, int | float) and not isinstance(value, bool)
    if not (number and low <= value <= high):
        expected = f"expected {low:,} to {high:,}{unit and ' ' + unit}"
        raise LumitreeError(f"{name} is {_number(value)}; {expected}")


def check_count(name: str, value: int, low: int, high: int) -> None:
    """Refuse a value that is not an int in [low, high], as `check_range`."""
    if type(value) is not int:
        raise LumitreeError(f"{name} is {_number(value)}; expected a whole number (int)")
    check_range(name, value, low, high)


def _number(value: object) -> str:
    """A number for a message, with its type if that is unusual."""
    return shown(value if isinstance(value, int | float) else repr(value), 40)


def check_items(name: str, values: object, kind: type) -> None:
    """Refuse a value that is not a sequence of objects of a type, such as a single one."""
    if not isinstance(values, Sequence) or isinstance(values, str):
        wrong = [values]
    else:
        wrong = [value for value in values if not isinstance(value, kind)]
    if wrong:
        found = shown(repr(wrong[0]), 60)
        raise LumitreeError(f"{name} has {found}; expected a list of lumitree.{kind.__name__}")


def check_choice(name: str, value: str, choices: Collection[str]) -> None:
    """Refuse a name that is not among the choices."""
    # A list is in no dictionary, and no error either.
    if value not in tuple(choices):
        raise LumitreeError(f"{name} is {shown(repr(value), 60)}; expected {', '.join(choices)}")


def check_choices(name: str, values: Collection[str], choices: Collection[str]) -> None:
    """Refuse names that are not among the choices, and one text in place of several."""
    if isinstance(values, str) or not isinstance(values, Collection):
        raise LumitreeError(f"{name}s are {shown(repr(values), 60)}; expected a list of texts")
    for value in values:
        check_choice(name, value, choices)


def check_gain(value: ArrayLike) -> tuple[float, float, float]:
    """Factors on the R, G and B of a lamp's light, from one number for all or from three.

    Args:
        value: a number or [3] numbers, 0 to `MAX_GAIN`.

    Raises:
        LumitreeError: it is something else.
    """
    try:
        gain = np.asarray(value, np.float64).ravel()
    except (TypeError, ValueError, RuntimeError):
        gain = np.zeros(0)
    if gain.size not in (1, 3) or not ((gain >= 0) & (gain <= MAX_GAIN)).all():
        found = gain.tolist() if gain.size > 1 else value
        raise LumitreeError(
            f"gain is {shown(found, 60)}; expected one number or three (R, G, B) from 0 to "
            f"{MAX_GAIN:,.0f}"
        )
    red, green, blue = np.broadcast_to(gain, 3).tolist()
    return red, green, blue


def check_light(lumens: float | None, temperature: float | None) -> None:
    """Refuse a luminous flux, lm, or a colour temperature, K, that is out of range."""
    if lumens is not None:
        check_range("lumens", lumens, MIN_LUMENS, MAX_LUMENS, "lm")
    if temperature is not None:
        check_range("temperature", temperature, MIN_KELVIN, MAX_KELVIN, "K")


def check_image_settings(**settings: int) -> None:
    """Refuse a resolution, a width or a number of samples that is out of range.

    Args:
        settings: `resolution` and `width` in pixels, `spp` in samples.
    """
    for name, value in settings.items():
        check_count(name, value, 1, MAX_SAMPLES if name == "spp" else MAX_PIXELS_A_SIDE)


def check_asset_output(path: str | os.PathLike[str]) -> None:
    """Refuse an asset's name that does not end in .lumitree, or cannot be written."""
    if Path(path).suffix != ".lumitree":
        raise LumitreeError(
            f"asset name {shown(repr(str(path)), 300)} does not end in .lumitree; choose one that "
            "does"
        )
    check_writable(path)


def check_sheet_output(path: str | os.PathLike[str], kind: str = "sheet") -> None:
    """Refuse an image file, by default a contact sheet, that is not .png or cannot be written."""
    if Path(path).suffix.lower() != ".png":
        raise LumitreeError(f"{kind} name {shown(repr(str(path)), 300)} does not end in .png")
    check_writable(path)


# Metres in a unit.
UNITS = {"m": 1.0, "cm": 0.01, "mm": 0.001, "in": 0.0254, "ft": 0.3048}


def metres_of(unit: float | str) -> float:
    """Metres in a unit of length.

    Args:
        unit: "m", "cm", "mm", "in" or "ft"; or the metres in a unit, 1e-6 to 1e6.

    Raises:
        LumitreeError: it is something else.
    """
    metres = UNITS.get(unit, 0.0) if isinstance(unit, str) else unit
    if not (isinstance(metres, int | float) and 1e-6 <= metres <= 1e6):
        expected = f"{', '.join(UNITS)}, or 1e-6 to 1e6 metres"
        raise LumitreeError(f"unit is {shown(repr(unit), 40)}; expected {expected}")
    return metres
