"""Settings of the light field."""

import dataclasses

from lumitree.asset.light_field import MAX_DEPTH
from lumitree.core.arguments import check_count
from lumitree.errors import LumitreeError

MAX_PATHS = 1 << 32
# Smallest depth of a grid whose depth is not stated.
LEAST_DEPTH = 5
# More bins are for intensities without noise, as photometric files have them.
MAX_TRACED_RESOLUTION = 128


@dataclasses.dataclass(frozen=True)
class LightFieldConfig:
    """Resolution of a light field, and the number of light paths that it is made from.

    Attributes:
        paths: light paths, rounded up to whole batches, 1 to 2³²; 2²¹ take 2 to 7 s on 2 CPU
            cores. More sharpen little: most of the error of irradiance then comes from the
            resolution.
        depth: the grid has 2**depth cells along the longest side of the box, 1 to 7. Cells blur
            the light of what is near: with 16 cells a side a plane that touches the box has an
            error of 1 to 6 %, with 32 of 1 %. None: 32 cells, or 64 or 128 for a lamp whose light
            starts in a small part of the box.
        resolution: bins of direction a side, a power of two. They blur the light of what is far.
        batch: paths that are traced at once, 1 to 2²⁴; bounds the memory.

    Raises:
        LumitreeError: a setting is out of range.
    """

    paths: int = 1 << 21
    depth: int | None = None
    resolution: int = 32
    batch: int = 1 << 19

    def __post_init__(self) -> None:
        check_count("light paths", self.paths, 1, MAX_PATHS)
        if self.depth is not None:
            check_count("depth of the light field", self.depth, 1, MAX_DEPTH)
        check_count("bins of direction a side", self.resolution, 4, MAX_TRACED_RESOLUTION)
        if self.resolution & (self.resolution - 1):
            raise LumitreeError(
                f"bins of direction a side is {self.resolution}; expected a power of two"
            )
        check_count("paths at once", self.batch, 1, 1 << 24)
