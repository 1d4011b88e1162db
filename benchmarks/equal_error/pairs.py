"""Pairs of a luminaire and a room at night: which lamp is where, and in which pixels it is seen."""

import dataclasses
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

SEEN_RAYS = 16  # a pixel, to tell which show the lamp
Place = Literal["hanging", "standing"]
# Centre of the lamp's box and its height, scene units, by room and place. The rooms have no light
# of their own; `standing` is on a table, or on the floor of the hall.
PLACES: dict[tuple[str, Place], tuple[tuple[float, float, float], float]] = {
    ("living_room", "hanging"): ((1.0, 2.45, -1.75), 0.85),
    ("living_room", "standing"): ((2.72, 0.83, -1.6), 0.4),
    ("veach_bidir", "hanging"): ((0.0, 6.78, -1.0), 2.4),
    ("veach_bidir", "standing"): ((-2.3, 2.7, -2.2), 1.6),
    ("modern_hall", "hanging"): ((-2.4, 4.85, 1.5), 1.5),
    ("modern_hall", "standing"): ((-0.5, 0.8, 1.6), 1.6),
}


@dataclasses.dataclass(frozen=True)
class Pair:
    """A luminaire, its asset and where both are in a room.

    Attributes:
        luminaire: source of the explicit lamp.
        asset: file of its bake.
        room: file of the room.
        at: [3] centre of the lamp's box, scene units.
        size: longest side of the box, scene units.
    """

    luminaire: Any
    asset: str
    room: str
    at: tuple[float, float, float]
    size: float

    @property
    def name(self) -> str:
        """For files: the asset's name and the folder of the room's file."""
        return f"{Path(self.asset).stem}-{Path(self.room).resolve().parent.name}"


def make_pair(luminaire: Any, asset: Path, rooms: Path, room: str, place: Place) -> Pair:
    """A luminaire at a place of a room; its height becomes a size by its own proportions.

    Args:
        rooms: folder of rooms, ROOM/room_night.xml.
        room: of `PLACES`.
    """
    from lumitree.lamp.luminaire import load_luminaire

    at, height = PLACES[room, place]
    size = load_luminaire(luminaire).size
    file = str(rooms / room / "room_night.xml")
    return Pair(luminaire, str(asset), file, at, float(height * size.max() / size[1]))


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
