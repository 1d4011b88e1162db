"""Pairs of a luminaire and a room: which lamp hangs where, and in which pixels it is seen."""

import argparse
import dataclasses
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

# The pairs of the published figures.
PAIRS = Path(__file__).parents[1] / "equal_quality_pairs.toml"
SEEN_RAYS = 16  # a pixel, to tell which show the lamp


@dataclasses.dataclass(frozen=True)
class Pair:
    """A luminaire, its asset and where both hang in a room."""

    luminaire: str
    asset: str
    room: str
    at: tuple[float, float, float]
    size: float
    bake_seconds: float | None = None

    @property
    def lamp_name(self) -> str:
        """Built-in name, or the folder of a file (and the file's own name where it says more)."""
        path = Path(self.luminaire)
        if not path.suffix:
            return self.luminaire
        folder = path.resolve().parent.name
        return folder if path.stem == "luminaire" else f"{folder}-{path.stem}"

    @property
    def room_name(self) -> str:
        """The folder of the room's file."""
        return Path(self.room).resolve().parent.name

    @property
    def name(self) -> str:
        """For files."""
        return f"{self.lamp_name}-{self.room_name}"


def add_folders(parser: argparse.ArgumentParser) -> None:
    """`--rooms`, `--assets` and `--data`: where the files of `read_pairs` are."""
    parser.add_argument(
        "--rooms", metavar="FOLDER", type=Path, default=Path("rooms"), help="ROOM/room_night.xml"
    )
    parser.add_argument(
        "--assets", metavar="FOLDER", type=Path, default=Path(), help="of the pairs' assets"
    )
    parser.add_argument(
        "--data", metavar="FOLDER", type=Path, default=Path(), help="of luminaires from files"
    )


def read_pairs(
    path: Path, rooms: Path, assets: Path, data: Path, only: str | None = None
) -> list[Pair]:
    """Pairs of a TOML file; heights become sizes by the luminaire's own proportions.

    Args:
        only: the luminaire, as the file has it, whose pairs are read; None for all.
    """
    from lumitree.lamp.loading import load_luminaire

    pairs = []
    for entry in tomllib.loads(path.read_text())["pair"]:
        name = entry["luminaire"]
        if only not in (None, name):
            continue
        source = str(data / name) if name.endswith(".xml") else name
        size = load_luminaire(source).size
        pairs.append(
            Pair(
                luminaire=source,
                asset=str(assets / entry["asset"]),
                room=str(rooms / entry["room"] / "room_night.xml"),
                at=tuple(entry["at"]),
                size=float(entry["height"] * size.max() / size[1]),
                bake_seconds=entry.get("bake_seconds"),
            )
        )
    return pairs


def shows_lamp(baked: Any) -> NDArray[np.bool_]:
    """Mask [H, W, 1] of pixels in which the box of the lamp is seen, or next to one."""
    import drjit as dr
    import mitsuba as mi

    sensor = baked.sensors()[0]
    width, height = sensor.film().size()
    random = mi.PCG32(width * height * SEEN_RAYS)
    index = dr.arange(mi.UInt32, width * height * SEEN_RAYS) // SEEN_RAYS
    pixel = mi.Point2f(index % width, index // width)
    position = (pixel + mi.Point2f(random.next_float32(), random.next_float32())) / mi.Point2f(
        width, height
    )
    ray, _ = sensor.sample_ray(0, 0, position, mi.Point2f(0.5))
    hit = baked.ray_intersect_preliminary(ray)
    seen = np.array(hit.is_valid() & (hit.shape.emitter() != None))  # noqa: E711
    seen = seen.reshape(height, width, SEEN_RAYS).any(axis=2)
    return np.asarray(binary_dilation(seen, iterations=2), np.bool_)[..., None]
