"""Where luminaires go in a scene, and the TOML file of placements."""

import contextlib
import dataclasses
import itertools
import json
import math
import numbers
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_gain, check_light
from lumitree.core.files import FilePath, write_bytes
from lumitree.core.frames import check_placement
from lumitree.core.results import plain
from lumitree.core.tables import converted, read_toml
from lumitree.errors import LumitreeError, explained, shown
from lumitree.lamp.builtin import BUILTIN
from lumitree.lamp.source import source_kind

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import LuminaireLike


_MAX_ARRAY = 10_000
_Numbers3 = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class Placement:
    """A luminaire in a scene.

    Attributes:
        source: an asset, or the path of a `.lumitree` file, a photometric file (`.ies`, `.ldt`,
            `.gldf`, `.tm33`) or a ray file (`.ray`, `.tm25ray`); or a luminaire, as for
            `lumitree.bake`, whose explicit geometry is placed.
        at: [3] centre of its bounding box, scene units; default: where its own file has it.
        size: largest side of its bounding box, scene units; default: its own size. It scales the
            luminous opening of a photometric file, whose intensities and flux stay; other lamps
            keep their radiance, so that their flux grows with the square of the scale.
        rotate: [4] axis x, y, z and angle in degrees, about the centre.
        gain: [3] factors on the R, G and B of its light, or one number for all; 0 to 10⁶. For an
            asset only.
        lumens: luminous flux that the lamp has in the scene before `gain`, lm, with lengths of the
            scene in the `unit` of `render` or `illuminance`; 10⁻⁶ to 10⁹. For an asset only.
            Default: its own, at its `size`.
        temperature: colour temperature of its whole flux before `gain`, K; 1000 to 20,000. R, G and
            B each get a factor, by which the colour in linear sRGB becomes a black body's; the
            luminous flux stays. For an asset only. Default: the colour of the asset.
        label: name of this placement in layers; default: file name without ending, made unique by
            a number.
        grid: numbers of equal lamps in an array around `at`, along x and z of the scene, or along
            x, y and z; together up to 10,000.
        pitch: distance between their centres in the same directions, scene units.

    Raises:
        LumitreeError: a number is out of range; there is a gain, a luminous flux or a temperature
            for explicit geometry; or `grid` is without `at` or `pitch`.
    """

    source: "Asset | LuminaireLike"
    at: tuple[float, float, float] | None = None
    size: float | None = None
    rotate: tuple[float, float, float, float] = (0.0, 1.0, 0.0, 0.0)
    gain: float | tuple[float, float, float] = 1.0
    lumens: float | None = None
    temperature: float | None = None
    label: str | None = None
    grid: tuple[int, int] | tuple[int, int, int] | None = None
    pitch: tuple[float, float] | tuple[float, float, float] | None = None

    def __post_init__(self) -> None:
        check_placement(self.at, self.size, self.rotate)
        if check_gain(self.gain) != (1.0, 1.0, 1.0) and not self.is_baked:
            raise LumitreeError(
                f"{self.name} has a gain of {shown(self.gain, 60)}, but is placed as explicit "
                "geometry; bake it first, or change its emitters"
            )
        check_light(self.lumens, self.temperature)
        for name, value in (("lumens", self.lumens), ("temperature", self.temperature)):
            if value is not None and not self.is_baked:
                raise LumitreeError(
                    f"{self.name} has {name} of {value:g}, but is placed as explicit geometry; "
                    "bake it first, or change its emitters"
                )

        if self.grid is not None or self.pitch is not None:
            self._check_array()

    def _check_array(self) -> None:
        grid, pitch = (() if each is None else tuple(each) for each in (self.grid, self.pitch))
        sizes = all(isinstance(each, numbers.Integral) and each >= 1 for each in grid)
        if not (2 <= len(grid) <= 3 and sizes and math.prod(grid) <= _MAX_ARRAY):
            raise LumitreeError(
                f"grid is {shown(self.grid, 60)}; expected 2 or 3 whole numbers from 1 on, of "
                f"{_MAX_ARRAY:,} lamps at most, such as 3x2"
            )
        if len(pitch) != len(grid) or not all(map(math.isfinite, pitch)):
            raise LumitreeError(
                f"pitch is {shown(self.pitch, 60)}; expected {len(grid)} distances, one for each "
                "number of the grid"
            )
        if self.at is None:
            raise LumitreeError(f"{self.name} has a grid; say by at where its centre is")

    def each(self) -> "list[Placement]":
        """The lamps of the array, x first; the placement itself without one."""
        if self.grid is None or self.pitch is None or self.at is None:
            return [self]
        axes = (0, 2) if len(self.grid) == 2 else (0, 1, 2)
        places = []
        for index in itertools.product(*map(range, reversed(self.grid))):
            at = list(self.at)
            for axis, place, count, step in zip(
                axes, reversed(index), self.grid, self.pitch, strict=True
            ):
                at[axis] += step * (place - (count - 1) / 2)
            places.append((at[0], at[1], at[2]))
        return [dataclasses.replace(self, at=at, grid=None, pitch=None) for at in places]

    def dimmed(self, level: float) -> "Placement":
        """The same lamp with `level` times its light."""
        red, green, blue = (level * each for each in check_gain(self.gain))
        gain = red if red == green == blue else (red, green, blue)
        return dataclasses.replace(self, gain=gain)

    @property
    def is_baked(self) -> bool:
        """Whether `source` is an asset once it is opened."""
        return source_kind(self.source) in ("asset", "photometric")

    @property
    def name(self) -> str:
        """Name of `source` in messages."""
        if isinstance(self.source, Asset):
            return shown(self.source.luminaire)
        return shown(getattr(self.source, "name", self.source), 200)


@dataclasses.dataclass(frozen=True)
class _Lamp:
    """Types of the keys of a lamp; `Placement` checks their ranges."""

    asset: str
    at: _Numbers3 | None = None
    size: float | None = None
    rotate: tuple[float, float, float, float] | None = None
    gain: float | _Numbers3 = 1.0
    lumens: float | None = None
    temperature: float | None = None
    grid: tuple[int, int] | tuple[int, int, int] | None = None
    pitch: tuple[float, float] | _Numbers3 | None = None


@dataclasses.dataclass(frozen=True)
class _File:
    lamps: dict[str, Any] = dataclasses.field(default_factory=dict)


@explained
def read_placements(path: str | os.PathLike[str]) -> list[Placement]:
    """Read placements from a TOML file, with a table `[lamps.NAME]` for each lamp.

    Its keys are `asset`, a file relative to the TOML file, or the name of a built-in luminaire;
    and `at`, `size`, `rotate`, `gain`, `lumens`, `temperature`, `grid` and `pitch`, as the
    attributes of `Placement`. NAME becomes `Placement.label`.

    Args:
        path: path of the TOML file.

    Returns:
        The placements, in the order of the file.

    Raises:
        LumitreeError: the file is missing or not TOML, a key is unknown, or a value is wrong.
    """
    path = Path(path)
    lamps = converted(read_toml(path, "a TOML file of placements"), _File, path).lamps
    if not lamps:
        raise LumitreeError(
            f"{shown(path, 300)} has no lamps; expected a table [lamps.NAME] for each"
        )
    placements = []
    for label, values in lamps.items():
        name = f"lamps.{shown(label)}"
        lamp = converted(values, _Lamp, path, name)
        source = lamp.asset if lamp.asset in BUILTIN else str(path.parent / lamp.asset)
        given = {key: getattr(lamp, key) for key in values if key != "asset"}
        try:
            placements.append(Placement(source, **given, label=label))
        except LumitreeError as error:
            raise LumitreeError(f"{shown(path, 300)}: {name}: {error}") from None
    return placements


def placements_toml(placements: Sequence[Placement], folder: FilePath) -> str:
    """Text of a TOML file of placements, which `read_placements` reads from a folder.

    Raises:
        LumitreeError: a placement has no label, or its source is no file.
    """
    tables = []
    for placement in placements:
        source = placement.source
        if placement.label is None or not isinstance(source, str | os.PathLike):
            raise LumitreeError(
                f"{placement.name} has no label, or is no file; a file of placements needs both"
            )
        asset = os.fspath(source)
        if asset not in BUILTIN:
            # Readable on other systems; Windows has no relative path to another drive.
            with contextlib.suppress(ValueError):
                asset = os.path.relpath(asset, folder)
            asset = Path(asset).as_posix()
        values: dict[str, Any] = {"asset": asset}
        written = {field.name for field in dataclasses.fields(_Lamp)}
        for field in dataclasses.fields(placement):
            value = getattr(placement, field.name)
            if field.name in written and value != field.default:
                values[field.name] = value
        lines = [f"{key} = {_toml(value)}" for key, value in values.items()]
        tables.append("\n".join([f"[lamps.{_toml(placement.label)}]", *lines, ""]))
    return "\n".join(tables)


def write_placements(path: FilePath, placements: Sequence[Placement]) -> None:
    """Write a TOML file of placements, as `read_placements` reads it.

    Args:
        path: path of the file; sources are written relative to its folder.
        placements: lamps with labels, whose sources are files or built-in lamps.

    Raises:
        LumitreeError: as for `placements_toml`; or the file cannot be written.
    """
    write_bytes(path, placements_toml(placements, Path(path).parent).encode())


def _toml(value: Any) -> str:
    """A text, a number or numbers in TOML, whose texts are written as in JSON."""
    return json.dumps(plain(value), ensure_ascii=False).replace("\x7f", "\\u007f")
