"""The TOML file of placements: a table `[lamps.NAME]` for each lamp.

Error messages contain the name of the file and of the lamp.
"""

import os
from pathlib import Path
from typing import Any

from lumitree.core.arguments import MAX_GAIN, MAX_KELVIN, MAX_LUMENS, MIN_KELVIN, MIN_LUMENS
from lumitree.core.frames import MAX_SCALE, MIN_SCALE
from lumitree.core.toml_table import Table, dictionary, number, numbers, read_toml, text
from lumitree.errors import LumitreeError, explained
from lumitree.lamp.builtin import BUILTIN
from lumitree.rendering.placement import Placement

_KIND = "a TOML file of placements"


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
    top = read_toml(path, _KIND)
    lamps = top.take("lamps", dictionary("[lamps.NAME] tables")) or {}
    top.finish()
    if not lamps:
        top.fail("it has no lamps; expected a table [lamps.NAME] for each")
    placements = []
    for name in lamps:
        table = Table(path, "lamps", lamps).table(name)
        assert table is not None
        placements.append(_placement(path, name, table))
    return placements


def _placement(path: Path, name: str, table: Table) -> Placement:
    asset = table.take("asset", text)
    values: dict[str, Any] = {
        "at": table.take("at", numbers(3)),
        "size": table.take("size", number(MIN_SCALE, MAX_SCALE)),
        "rotate": table.take("rotate", numbers(4)),
        "gain": table.take("gain", numbers(1, 3)),
        "lumens": table.take("lumens", number(MIN_LUMENS, MAX_LUMENS)),
        "temperature": table.take("temperature", number(MIN_KELVIN, MAX_KELVIN)),
    }
    table.finish()
    if asset is None:
        table.fail(
            f"{table.name} has no asset; expected a .lumitree file, a photometric file "
            "or a luminaire"
        )
    if any(not 0 <= factor <= MAX_GAIN for factor in values["gain"] or ()):
        table.fail(f"{table.name}.gain has a factor that is not from 0 to {MAX_GAIN:,.0f}")
    source = asset if asset in BUILTIN else str(path.parent / asset)
    given = {key: value for key, value in values.items() if value is not None}
    try:
        return Placement(source, **given, label=name)
    except LumitreeError as error:
        table.fail(f"{table.name}: {error}")
