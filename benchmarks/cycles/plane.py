"""Illuminance of a horizontal plane, from images of it by Cycles."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.cycles.room import CyclesJob, render_cycles
from lumitree.core.photometry import LUMA, LUMENS_PER_WATT

# The camera above the plane, as a part of the plane's side.
_HEIGHT = 0.25


def plane_lux(
    program: str,
    script: Path,
    centre: NDArray[np.float64],
    side: float,
    count: int,
    samples: int,
    seeds: list[int],
) -> tuple[NDArray[np.float64], NDArray[np.float64], str]:
    """Illuminance [N²] of the direct light of a lamp, its standard error, and the version.

    A white diffuse plane that faces up is seen from straight above by an orthographic camera, a
    quarter of its side above it, which has to be below the lamp. Its radiance is its irradiance
    over π.

    Args:
        program: from `find_blender`.
        script: the exported lamp, at the place of its own file.
        centre: [3] of the plane, m, y up.
        side: of the plane, m.
        count: points a side, N, in the middles of equal squares; rows of z, columns of x.
        samples: of each point and seed.
        seeds: two at least.
    """
    x, y, z = centre.tolist()
    half = side / 2
    white: dict[str, Any] = {"centre": [x, y, z], "first": [half, 0, 0], "second": [0, 0, -half]}
    job = CyclesJob(
        str(script),
        explicit=False,
        at=[0.0, 0.0, 0.0],
        width=count,
        height=count,
        samples=samples,
        seeds=seeds,
        walls={"plane": {**white, "reflectance": [1.0, 1.0, 1.0]}},
        camera={"origin": [x, y + _HEIGHT * side, z], "target": [x, y, z], "width": side},
        pixel_centres=True,
        diffuse_bounces=0,
    )
    found = render_cycles(program, job)
    lux = np.pi * LUMENS_PER_WATT * (found.images.astype(np.float64) @ np.array(LUMA))
    lux = lux.reshape(len(seeds), -1)
    return lux.mean(axis=0), lux.std(axis=0, ddof=1) / np.sqrt(len(seeds)), found.version
