"""Luminaires that a benchmark measures: built-in ones, and the luminaires of a folder."""

import argparse
from pathlib import Path

from lumitree.lamp.builtin import BUILTIN
from lumitree.lamp.source import LuminaireSource

OVERRIDES = Path(__file__).parents[2] / "examples" / "overrides"
# File, overrides, and metres in a unit of what is loaded.
DATA = (
    ("scopia_chandelier/luminaire.xml", None, 0.01),
    ("scopia_chandelier/original/chandelier-lamp.obj", "chandelier-lamp.toml", 1.0),
    ("megeon_chandelier/luminaire.xml", None, 0.01),
    ("megeon_chandelier/original/lamp2.obj", "lamp2.toml", 1.0),
    ("little_lamp/luminaire.xml", None, 0.1),
    ("barn_lamp/AnisotropyBarnLamp.gltf", None, 1.0),
    ("stained_glass_lamp/StainedGlassLamp.gltf", "stained_glass_lamp.toml", 1.0),
)


def add_luminaires(parser: argparse.ArgumentParser) -> None:
    """The arguments of `sources`."""
    parser.add_argument("luminaires", metavar="LUMINAIRE", nargs="*", default=list(BUILTIN))
    parser.add_argument("--data", metavar="FOLDER", type=Path, help="with the luminaires of others")


def sources(names: list[str], data: Path | None) -> list[tuple[LuminaireSource, float]]:
    """The luminaires to measure, each with the metres in its unit."""
    found = [(LuminaireSource(name), 1.0) for name in names]
    if data is None:
        return found
    for file, overrides, unit in DATA:
        materials = None if overrides is None else str(OVERRIDES / overrides)
        found.append((LuminaireSource(str(data / file), materials=materials), unit))
    return found


def file_name(source: LuminaireSource) -> str:
    """Name of the files of a luminaire; files of one name differ by their folder."""
    path = Path(source.name)
    return path.stem if path.suffix == "" else f"{path.parent.name}-{path.stem}"
