"""JSON objects of a glTF file, read with checks; errors state the place in the file."""

import math
import reprlib
from typing import Any

from lumitree.errors import LumitreeError, shown

# Larger lengths, factors and offsets are refused: the file is damaged. Products of two values are
# still in the range of single precision.
MAX_MAGNITUDE = 1e15


class Item:
    """A JSON object; every reader checks the type and the range of what it returns.

    `where` is its place in the file, for messages, such as `lamp.gltf: materials[3]`.
    """

    def __init__(self, data: Any, where: str) -> None:
        self.where = where
        if not isinstance(data, dict):
            raise self.error(f"is {_shown(data)}; expected a JSON object")
        self.data: dict[str, Any] = data

    def __contains__(self, key: str) -> bool:
        return key in self.data

    def error(self, message: str) -> LumitreeError:
        """The error to raise: the place of the object in the file, and the message."""
        return LumitreeError(f"{self.where} {message}")

    def number(
        self, key: str, default: float, low: float = -math.inf, high: float = math.inf
    ) -> float:
        """A number in [low, high], and of at most MAX_MAGNITUDE."""
        value = self.data.get(key, default)
        if not _is_number(value) or not low <= value <= high:
            raise self._wrong(key, value, f"a number{_range(low, high)}")
        return float(value)

    def numbers(
        self,
        key: str,
        default: tuple[float, ...],
        low: float = -math.inf,
        high: float = math.inf,
    ) -> tuple[float, ...]:
        """As many finite numbers in [low, high] as there are defaults."""
        value = self.data.get(key, default)
        if (
            not isinstance(value, list | tuple)
            or len(value) != len(default)
            or not all(_is_number(entry) and low <= entry <= high for entry in value)
        ):
            raise self._wrong(key, value, f"{len(default)} numbers{_range(low, high)}")
        return tuple(float(entry) for entry in value)

    def integer(self, key: str, default: int | None = None, low: int = 0) -> int:
        """An integer that is at least `low`; an error where it is missing without a default."""
        value = self.data.get(key, default)
        if isinstance(value, bool) or not isinstance(value, int) or value < low:
            raise self._wrong(key, value, f"an integer of at least {low}")
        return value

    def index(self, key: str) -> int | None:
        """An index into one of the file's lists; None where it is missing."""
        return self.integer(key) if key in self.data else None

    def indices(self, key: str) -> list[int]:
        """A list of indices; empty where it is missing."""
        value = self.data.get(key, [])
        if not isinstance(value, list):
            raise self._wrong(key, value, "a list")
        for entry in value:
            if isinstance(entry, bool) or not isinstance(entry, int) or entry < 0:
                raise self._wrong(key, entry, "indices of at least 0")
        return value

    def string(self, key: str, default: str) -> str:
        value = self.data.get(key, default)
        if not isinstance(value, str):
            raise self._wrong(key, value, "a string")
        return value

    def flag(self, key: str) -> bool:
        """True or false; false where it is missing."""
        value = self.data.get(key, False)
        if not isinstance(value, bool):
            raise self._wrong(key, value, "true or false")
        return value

    def item(self, key: str) -> "Item":
        """An object; an empty one where it is missing."""
        return Item(self.data.get(key, {}), f"{self.where}.{key}")

    def items(self, key: str) -> list["Item"]:
        """A list of objects; empty where it is missing."""
        value = self.data.get(key, [])
        if not isinstance(value, list):
            raise self._wrong(key, value, "a list")
        return [Item(entry, f"{self.where}.{key}[{i}]") for i, entry in enumerate(value)]

    def strings(self, key: str) -> list[str]:
        """A list of strings; empty where it is missing."""
        value = self.data.get(key, [])
        if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
            raise self._wrong(key, value, "a list of strings")
        return value

    def extension(self, name: str) -> "Item | None":
        """An extension's object; None where the extension is not used here."""
        extensions = self.item("extensions")
        return extensions.item(name) if name in extensions else None

    def _wrong(self, key: str, value: Any, expected: str) -> LumitreeError:
        found = "is missing" if value is None else f"is {_shown(value)}"
        return self.error(f"is damaged: {key} {found}; expected {expected}")


def _is_number(value: Any) -> bool:
    # bool is a kind of int; not a number compares false.
    number = isinstance(value, int | float) and not isinstance(value, bool)
    return number and abs(value) <= MAX_MAGNITUDE


def _range(low: float, high: float) -> str:
    if low == -math.inf and high == math.inf:
        return ""
    return f" in [{low:g}, {high:g}]"


def _shown(value: Any) -> str:
    # A list of any length or depth.
    return shown(reprlib.repr(value), 40)
