"""Small lamps, written as scenes."""

import json
from collections.abc import Sequence
from pathlib import Path

import numpy as np

from lumitree.core.files import write_bytes, write_json
from lumitree.errors import LumitreeError

SCENE = '<scene version="3.0.0">\n{}\n</scene>\n'
LIGHT = '<emitter type="area"><rgb name="radiance" value="{}"/></emitter>'
GLASS = '<bsdf type="dielectric"/>'
METAL = (
    '<bsdf type="twosided"><bsdf type="roughconductor"><string name="material" value="{}"/>'
    '<float name="alpha" value="{:.3f}"/></bsdf></bsdf>'
)
WHITE = (
    '<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0.8"/></bsdf></bsdf>'
)


def lamp(index: int, seed: int) -> str:
    """Scene of a pendant, a table lamp or a panel, with random sizes and materials."""
    random = np.random.default_rng([seed, index])
    size, radius = random.uniform(0.8, 1.2), random.uniform(0.03, 0.05)
    metal = METAL.format(random.choice(["Al", "Cu", "Au", "Cr"]), random.uniform(0.05, 0.3))
    light = LIGHT.format(f"{random.uniform(2e3, 2e4):.1f}")
    bulb = [
        _shape("sphere", (radius,) * 3, (0, 0, 0), GLASS),
        _shape("sphere", (0.3 * radius,) * 3, (0, 0, 0), light),
    ]
    match index % 3:
        case 0:
            shapes = [*bulb, _shape("cylinder", (0.1 * size, 0.1 * size, 0.2), (0, 0, -0.1), metal)]
        case 1:
            shapes = [
                *bulb,
                _shape("cylinder", (0.12 * size, 0.12 * size, 0.15), (0, 0, -0.05), WHITE),
                _shape("cylinder", (0.01, 0.01, 0.3), (0, 0, -0.37), metal),
                _shape("disk", (0.08 * size,) * 3, (0, 0, -0.37), metal),
            ]
        case _:
            shapes = [
                _shape("rectangle", (0.3 * size, 0.05, 1), (0, 0, 0), light),
                _shape("cube", (0.32 * size, 0.07, 0.02), (0, 0, -0.03), WHITE),
            ]
    return SCENE.format("\n".join(shapes))


def _shape(kind: str, scale: Sequence[float], at: Sequence[float], inside: str) -> str:
    """An analytic shape, scaled and moved."""
    sides = " ".join(f'{axis}="{value:.5f}"' for axis, value in zip("xyz", scale, strict=True))
    place = " ".join(f'{axis}="{value:.5f}"' for axis, value in zip("xyz", at, strict=True))
    return (
        f'<shape type="{kind}"><transform name="to_world"><scale {sides}/><translate {place}/>'
        f"</transform>{inside}</shape>"
    )


def write_lamps(work: Path, count: int, seed: int) -> None:
    """Write the scenes and their list; refuses a folder of another number or seed."""
    settings = {"lamps": count, "seed": seed}
    path = work / "settings.json"
    if path.is_file():
        if json.loads(path.read_text(encoding="utf-8")) != settings:
            raise LumitreeError(f"{work.name} has other lamps; choose another folder with --work")
        return
    (work / "lamps").mkdir(parents=True, exist_ok=True)
    names = [f"lamps/lamp-{index:05d}.xml" for index in range(count)]
    for index, name in enumerate(names):
        (work / name).write_text(lamp(index, seed), encoding="utf-8")
    write_bytes(work / "lamps.txt", "".join(f"{name}\n" for name in names).encode())
    write_json(path, settings)
