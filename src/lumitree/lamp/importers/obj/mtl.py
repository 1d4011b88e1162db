"""The text of an MTL file as values and maps, which are not interpreted here."""

import dataclasses
import math
import warnings
from pathlib import Path

from lumitree.core.file_kinds import in_utf8
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.lamp.importers.obj.numbers import readable, with_point

_MAX_BYTES = 16 * 2**20
# Keys with up to three numbers, spelled as below whatever case the file has.
_VALUES = ("Ka", "Kd", "Ks", "Ke", "Tf", "Ns", "Ni", "d", "Tr", "illum")
_VALUES += ("Pr", "Pm", "Ps", "Pc", "Pcr", "aniso", "anisor", "sharpness")
_NAMES = {key.lower(): key for key in _VALUES}
_COLOURS = ("Ka", "Kd", "Ks", "Ke", "Tf")
_MAPS = {
    "map_bump": "bump",
    "bump": "bump",
    "norm": "norm",
    "map_kn": "norm",
    "map_norm": "norm",
    "disp": "disp",
    "map_disp": "disp",
    "decal": "decal",
    "refl": "refl",
    "map_refl": "refl",
    "map_tr": "map_d",
    "map_opacity": "map_d",
}
_MAX_VALUE = 1e9
# Numbers that an option takes at most, and those with which it changes nothing.
_NUM_VALUES = {"-s": 3, "-o": 3, "-t": 3, "-mm": 2, "-bm": 1, "-boost": 1, "-texres": 1}
_NEUTRAL = {"-mm": [0.0, 1.0], "-t": [0.0, 0.0, 0.0], "-boost": [0.0]}


@dataclasses.dataclass(frozen=True)
class MtlMap:
    """An image that a material names.

    `scale` and `offset` are of u and v, with v = 0 at the image's last row, as in the file. `clamp`
    limits texture coordinates to [0, 1]; `ignored` options have no effect here.
    """

    file: str
    scale: tuple[float, float] = (1.0, 1.0)
    offset: tuple[float, float] = (0.0, 0.0)
    clamp: bool = False
    bump_scale: float = 1.0
    ignored: tuple[str, ...] = ()


@dataclasses.dataclass
class MtlMaterial:
    """A `newmtl` block: numbers by key, and maps by key."""

    values: dict[str, tuple[float, ...]] = dataclasses.field(default_factory=dict)
    maps: dict[str, MtlMap] = dataclasses.field(default_factory=dict)


def parse_mtl(path: Path) -> dict[str, MtlMaterial]:
    """Materials of an MTL file of at most 16 MiB by name; the first of a name counts."""
    materials: dict[str, MtlMaterial] = {}
    current = MtlMaterial()
    lines = in_utf8(read_bytes(path, "an MTL file", _MAX_BYTES)).split(b"\n")
    for number, line in enumerate(lines, 1):
        words = readable(line.strip().replace(b"\t", b" ")).split(None, 1)
        if not words or words[0].startswith("#"):
            continue
        key, rest = words[0].lower(), words[1].strip() if len(words) > 1 else ""
        where = f"{path}, line {number}"
        if key == "newmtl":
            current = MtlMaterial()
            materials.setdefault(rest, current)
        elif key in _NAMES:
            _add_value(current, _NAMES[key], rest, where)
        elif key.startswith("map_") or key in _MAPS:
            name = _MAPS.get(key) or "map_" + _NAMES.get(key[4:], key[4:])
            current.maps[name] = _map(rest, where)
    return materials


def _add_value(material: MtlMaterial, key: str, text: str, where: str) -> None:
    words = text.partition("#")[0].split()
    if words and words[0] in ("spectral", "xyz"):
        warnings.warn(
            f"{where}: {key} {words[0]} is not supported and left out; write R G B",
            LumitreeWarning,
            stacklevel=3,
        )
        return
    if key == "d" and words and words[0] == "-halo":
        words = words[1:]
    values = tuple(_number(word, key, where) for word in words[:3])
    if len(values) not in ((1, 3) if key in _COLOURS else (1, 2, 3)):
        raise LumitreeError(f"{where}: {key} has {len(values)} numbers; expected R G B or one")
    material.values[key] = values * 3 if key in _COLOURS and len(values) == 1 else values


def _number(word: str, key: str, where: str) -> float:
    try:
        value = float(with_point(word))
    except ValueError:
        value = math.nan
    if not abs(value) <= _MAX_VALUE:
        raise LumitreeError(f"{where}: {key} has {shown(word)!r}; expected a finite number")
    return value


def _map(text: str, where: str) -> MtlMap:
    """A map: options with their values, then the name of the image, which may contain spaces."""
    words, result, ignored = text.split(), {}, []
    while words and words[0].startswith("-"):
        option = words.pop(0).lower()
        numbers = _leading_numbers(words, option, where)
        if option in ("-s", "-o") and numbers:
            default = 1.0 if option == "-s" else 0.0
            result["scale" if option == "-s" else "offset"] = (
                numbers[0],
                numbers[1] if len(numbers) > 1 else default,
            )
        elif option == "-bm" and numbers:
            result["bump_scale"] = numbers[0]
        elif option == "-clamp" and words:
            result["clamp"] = words.pop(0).lower() == "on"
        elif option in ("-blendu", "-blendv", "-cc", "-imfchan", "-type") and words:
            word = words.pop(0).lower()
            if (option, word) not in (("-blendu", "on"), ("-blendv", "on"), ("-cc", "off")):
                ignored.append(f"{option} {word}")
        elif numbers != _NEUTRAL.get(option):
            ignored.append(option)
    if not words:
        raise LumitreeError(f"{where}: a map without the name of an image")
    # Cut from the text itself, which keeps runs of spaces inside a name.
    file = text.split(None, len(text.split()) - len(words))[-1]
    return MtlMap(file.strip().strip('"'), ignored=tuple(ignored), **result)


def _leading_numbers(words: list[str], option: str, where: str) -> list[float]:
    """Take an option's numbers off the words; as many as are there, up to its own count."""
    numbers: list[float] = []
    while words and len(numbers) < _NUM_VALUES.get(option, 0):
        try:
            float(with_point(words[0]))
        except ValueError:
            break
        numbers.append(_number(words.pop(0), option, where))
    return numbers
