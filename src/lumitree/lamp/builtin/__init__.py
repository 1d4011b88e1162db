"""Built-in luminaires.

Frame of every lamp: metres, y up, the origin where it meets the ceiling (hanging lamps) or what it
stands on. Emitted radiance is in W/(m² sr) for each of R, G and B; its scale is
arbitrary.

Glass walls are solid: an outer and an inner surface around them, each closed, normals out of the
glass. Nothing touches the glass, and every filament is an emitter of its own, because Mitsuba
chooses among emitters uniformly and all filaments are equally bright. Metal parts may overlap
where they are joined. Equal parts share one mesh.
"""

import dataclasses
from collections.abc import Callable

from lumitree.lamp.builtin import bulbs, lanterns, neoclassical
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
        bulbs.build_bulbs,
    ),
    Builtin(
        "dallas",
        "stand-in for the paper's Dallas: eight clear bulbs below a steel hoop, 0.65 m",
        bulbs.build_dallas,
    ),
    Builtin(
        "cluster",
        "stand-in for the paper's Cluster: thirteen cast-glass globes, clear and tinted, 0.56 m",
        bulbs.build_cluster,
    ),
    Builtin(
        "neoclassical",
        "stand-in for the paper's Neoclassical: crystal chandelier of eighteen arms, 0.95 m",
        neoclassical.build_neoclassical,
    ),
    Builtin(
        "portica",
        "stand-in for the paper's Portica: arcaded lantern, opal roof, seven flame bulbs, 0.83 m",
        lanterns.build_portica,
    ),
    Builtin(
        "star",
        "stand-in for the paper's Star: Moravian star of scattering opal glass, 0.75 m",
        lanterns.build_star,
    ),
    Builtin(
        "arc",
        "arc floor lamp: an opal globe on a long curved steel arm, 2.05 m",
        bulbs.build_arc,
    ),
)
BUILTIN: dict[str, Builtin] = {builtin.name: builtin for builtin in _ALL}
