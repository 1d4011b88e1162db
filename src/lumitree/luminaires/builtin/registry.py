"""The table of built-in luminaires."""

import dataclasses
from collections.abc import Callable

from lumitree.luminaires.builtin import bulbs
from lumitree.luminaires.model import Model


@dataclasses.dataclass(frozen=True)
class Builtin:
    """A luminaire that comes with lumitree; `build` makes the same model every time."""

    name: str
    description: str
    build: Callable[[], Model]


_ALL = (
    Builtin(
        "bulbs",
        "five clear glass bulbs with coiled filaments on a hanging frame, 0.33 m",
        bulbs.build,
    ),
)
BUILTIN: dict[str, Builtin] = {builtin.name: builtin for builtin in _ALL}
