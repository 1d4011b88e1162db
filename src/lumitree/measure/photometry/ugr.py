"""The table of Unified Glare Ratings of a luminaire, CIE 117:1995 and CIE 190:2010.

The rating of a room with a regular ceiling of equal luminaires is

    UGR = 8 log₁₀(0.25 / L_b · Σ L² ω / p²)

with the luminance L of each luminaire towards an observer, cd/m², the solid angle ω of its luminous
area, its position index p by Guth, and the luminance L_b of the background. The package
`eulumdat-ugr` has the tables of CIE 117 and CIE 190; it is optional.
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.formats.ldt import ldt_of
from lumitree.formats.type_c import IntensityDistribution

# Sides of the rooms across and along the line of sight, in mounting heights above the eye.
ROOMS = (
    *((2, y) for y in (2, 3, 4, 6, 8, 12)),
    *((4, y) for y in (2, 3, 4, 6, 8, 12)),
    *((8, y) for y in (4, 6, 8, 12)),
    *((12, y) for y in (4, 6, 8)),
)
# Reflectances of ceiling, walls and floor, percent.
REFLECTANCES = ("70/50/20", "70/30/20", "50/50/20", "50/30/20", "30/30/20")
# Where the one number of catalogues is: the room 4H x 8H, the first reflectances.
CATALOGUE_ROOM = ROOMS.index((4, 8))


def ugr_table(distribution: IntensityDistribution) -> NDArray[np.float64] | None:
    """The table of ratings.

    Luminaires are a quarter of the mounting height of 2 m apart. Only intensities from C0 to C90
    are used, as if the luminaire were symmetrical. Its luminous area is its opening's.

    Returns:
        [19, 10] ratings by `ROOMS`, and by `REFLECTANCES` for lamps seen crosswise (their C0 plane
        is along the line of sight) and then endwise. NaN where no light comes from below 85
        degrees. None if the package `eulumdat-ugr` is not installed.
    """
    try:
        from eulumdat_ugr import UgrCalculator
    except ImportError:
        return None
    # Without a flux of bare emitters the file would state absolute photometry by a number of -1.
    known = dataclasses.replace(
        distribution, emitted_lumens=distribution.emitted_lumens or distribution.lumens
    )
    if not (known.lumens > 0 and max(known.opening.sides) > 0):
        return np.full((len(ROOMS), 2 * len(REFLECTANCES)), np.nan)
    with np.errstate(all="ignore"):
        return np.asarray(UgrCalculator.compute(ldt_of(known)).values, np.float64)
