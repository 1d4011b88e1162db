"""The table of built-in luminaires."""

import dataclasses
from collections.abc import Callable

from lumitree.lamp.builtin import arc, bulbs, cluster, dallas, neoclassical, portica, star
from lumitree.lamp.parts import Geometry


@dataclasses.dataclass(frozen=True)
class Builtin:
    """A luminaire that comes with lumitree; `build` makes the same model every time."""

    name: str
    description: str
    build: Callable[[], Geometry]


_ALL = (
    Builtin(
        "bulbs",
        "five clear glass bulbs with coiled filaments on a hanging frame, 0.33 m",
        bulbs.build,
    ),
    Builtin(
        "dallas",
        "stand-in for the paper's Dallas: eight clear bulbs below a steel hoop, 0.65 m",
        dallas.build,
    ),
    Builtin(
        "cluster",
        "stand-in for the paper's Cluster: thirteen cast-glass globes, clear and tinted, 0.56 m",
        cluster.build,
    ),
    Builtin(
        "neoclassical",
        "stand-in for the paper's Neoclassical: crystal chandelier of eighteen arms, 0.95 m",
        neoclassical.build,
    ),
    Builtin(
        "portica",
        "stand-in for the paper's Portica: arcaded lantern, opal roof, seven flame bulbs, 0.83 m",
        portica.build,
    ),
    Builtin(
        "star",
        "stand-in for the paper's Star: Moravian star of scattering opal glass, 0.75 m",
        star.build,
    ),
    Builtin(
        "arc",
        "arc floor lamp: an opal globe on a long curved steel arm, 2.05 m",
        arc.build,
    ),
)
BUILTIN: dict[str, Builtin] = {builtin.name: builtin for builtin in _ALL}
