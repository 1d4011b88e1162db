"""Lamps that both programs get: photometric files, and a lamp by its surfaces.

Each class has `placement(folder, at)`, the lamp in lumitree with the centre of its box at a point
[3], and `radiance(program, placement)`, the text of the same lamp in Radiance.
"""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.radiance_rooms.program import LUMENS_PER_WATT, Radiance
from benchmarks.radiance_rooms.rooms import Box, mitsuba_shapes, radiance_text
from lumitree.core.photometry import LUMENS_PER_WATT as LUMITREE_LUMENS_PER_WATT
from lumitree.formats.ies import write_ies
from lumitree.formats.type_c import IntensityDistribution
from lumitree.rendering.placement import Placement

Point = tuple[float, float, float]


@dataclasses.dataclass(frozen=True)
class FileLamp:
    """An IES file, which both programs read.

    Attributes:
        distribution: what the file holds.
    """

    distribution: IntensityDistribution

    def placement(self, folder: Path, at: Point) -> Placement:
        path = folder / f"{self.distribution.name}.ies"
        write_ies(path, self.distribution)
        return Placement(path, at=at)

    def radiance(self, program: Radiance, placement: Placement) -> str:
        return program.photometric_source(Path(str(placement.source)), _place(placement))


@dataclasses.dataclass(frozen=True)
class ShadedLamp:
    """A square that emits downwards, at the top of a black box that is open below.

    lumitree bakes it; Radiance gets its surfaces. They reflect nothing, because lumitree counts
    what a lamp's own surfaces reflect as its direct light.

    Attributes:
        half: half side of the square, m.
        luminance: of the square, cd/m².
        paths: light paths of the bake.
        seed: of the bake.
    """

    half: float = 0.08
    luminance: float = 20_000.0
    paths: int = 1 << 22
    seed: int = 0

    def placement(self, folder: Path, at: Point) -> Placement:
        import mitsuba as mi

        import lumitree

        watts = self.luminance / LUMITREE_LUMENS_PER_WATT
        # A rectangle of Mitsuba faces +z.
        turned = mi.ScalarTransform4f().translate([0, _SQUARE, 0]).rotate([1, 0, 0], 90)
        square = {
            "type": "rectangle",
            "to_world": turned.scale([self.half, self.half, 1]),
            "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}},
            "emitter": {"type": "area", "radiance": {"type": "rgb", "value": watts}},
        }
        scene: dict[str, Any] = {"type": "scene", **mitsuba_shapes(_shade()), "square": square}
        config = lumitree.BakeConfig(
            parts=("light", "geometry"),
            irradiance_paths=0,
            light=lumitree.LightFieldConfig(paths=self.paths),
            seed=self.seed,
        )
        return Placement(lumitree.bake(scene, None, config).asset, at=at)

    def radiance(self, program: Radiance, placement: Placement) -> str:
        watts = " ".join([f"{self.luminance / LUMENS_PER_WATT:.9g}"] * 3)
        corners = np.array([(-1, -1), (-1, 1), (1, 1), (1, -1)]) * self.half
        # z up, and clockwise seen from above: it faces down.
        places = " ".join(f"{x:.9g} {y:.9g} {_SQUARE:.9g}" for x, y in corners)
        text = f"void light glowing 0 0 3 {watts}\nglowing polygon square 0 0 12 {places}\n"
        return program.moved(radiance_text(_shade(), "shade") + text, _place(placement))


def _place(placement: Placement) -> Point:
    assert placement.at is not None
    return placement.at


# Height of the square, from the middle of the box.
_SQUARE = 0.085


def _shade() -> list[Box]:
    """A box of 0.3 x 0.2 x 0.3 m around the origin without its lower side."""
    outer, inner, half, black = 0.15, 0.14, 0.1, 0.0
    return [
        Box((-outer, half - 0.01, -outer), (outer, half, outer), black),
        Box((-outer, -half, -outer), (-inner, half - 0.01, outer), black),
        Box((inner, -half, -outer), (outer, half - 0.01, outer), black),
        Box((-inner, -half, -outer), (inner, half - 0.01, -inner), black),
        Box((-inner, -half, inner), (inner, half - 0.01, outer), black),
    ]
