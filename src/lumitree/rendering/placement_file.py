"""The TOML file of placements: a table `[lamps.NAME]` for each lamp.

Error messages contain the name of the file and of the lamp.
"""

import dataclasses
import os
from pathlib import Path
from typing import Any

from lumitree.core.toml_file import converted, read_toml
from lumitree.errors import LumitreeError, explained, shown
from lumitree.lamp.builtin import BUILTIN
from lumitree.rendering.placement import Placement

_Numbers3 = tuple[float, float, float]


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


@dataclasses.dataclass(frozen=True)
class _File:
    lamps: dict[str, Any] = dataclasses.field(default_factory=dict)


@explained
def read_placements(path: str | os.PathLike[str]) -> list[Placement]:
    """Read placements from a TOML file, with a table `[lamps.NAME]` for each lamp.

    Its keys are `asset`, a file relative to the TOML file, or the name of a built-in luminaire;
    and `at`, `size`, `rotate`, `gain`, `lumens` and `temperature`, as the attributes of
    `Placement`. NAME becomes `Placement.label`.

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
