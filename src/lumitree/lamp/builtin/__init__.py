"""Built-in luminaires.

Frame of every lamp: metres, y up, the origin where it meets the ceiling (hanging lamps) or what it
stands on. Emitted radiance is in W/(m² sr) for each of R, G and B; its scale is
arbitrary.

Glass walls are solid: an outer and an inner surface around them, each closed, normals out of the
glass. Nothing touches the glass, and every filament is an emitter of its own, because Mitsuba
chooses among emitters uniformly and all filaments are equally bright. Metal parts may overlap
where they are joined. Equal parts share one mesh.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from lumitree.core.results import Json
from lumitree.lamp.builtin import bulbs, lanterns, neoclassical
from lumitree.lamp.parts import Geometry


class Builtin(NamedTuple):
    """A luminaire that comes with lumitree; `build` makes the same model every time."""

    description: str
    build: Callable[[], Geometry]

    def figures(self) -> Json:
        """The lamp in numbers, see `builtin_luminaires`."""
        model = self.build()
        radiances = [model.material(part).radiance for part in model.parts for _ in part.places]
        emitted = [each for each in radiances if isinstance(each, tuple)]
        points = [part.placed(at) for part in model.parts for at in range(len(part.places))]
        x, y, z = np.ptp(np.concatenate(points), axis=0).tolist()
        return {
            "description": self.description,
            "triangles": sum(len(part.mesh.faces) * len(part.places) for part in model.parts),
            "emitters": len(emitted),
            "emitted_radiance": max(map(max, emitted)),
            "size": (x, y, z),
            "has_media": any(model.material(part).medium is not None for part in model.parts),
        }


_PAPER = "stand-in for the paper's"
BUILTIN: dict[str, Builtin] = {
    "bulbs": Builtin(
        "five clear glass bulbs with coiled filaments on a hanging frame, 0.33 m", bulbs.build_bulbs
    ),
    "dallas": Builtin(
        f"{_PAPER} Dallas: eight clear bulbs below a steel hoop, 0.65 m", bulbs.build_dallas
    ),
    "cluster": Builtin(
        f"{_PAPER} Cluster: thirteen cast-glass globes, clear and tinted, 0.56 m",
        bulbs.build_cluster,
    ),
    "neoclassical": Builtin(
        f"{_PAPER} Neoclassical: crystal chandelier of eighteen arms, 0.95 m",
        neoclassical.build_neoclassical,
    ),
    "portica": Builtin(
        f"{_PAPER} Portica: arcaded lantern, opal roof, seven flame bulbs, 0.83 m",
        lanterns.build_portica,
    ),
    "star": Builtin(
        f"{_PAPER} Star: Moravian star of scattering opal glass, 0.75 m", lanterns.build_star
    ),
    "arc": Builtin(
        "arc floor lamp: an opal globe on a long curved steel arm, 2.05 m", bulbs.build_arc
    ),
}
