"""Point lights as IES profiles: each has a luminous intensity by direction, and one colour.

The frame of a light has z up: a profile's γ is the angle from -z, and its C that from +x about z,
counter-clockwise seen from +z. It is turned so that its z is the program's y, which is up.

Symbols
    R   bins of direction a side, as in `output.point_lights`
"""

import dataclasses

import numpy as np
from numpy.typing import NDArray

from lumitree.core.octahedral import bilinear_bins
from lumitree.core.photometry import LUMENS_PER_WATT, RGB, luminance
from lumitree.formats.type_c import Grid, IntensityDistribution, direction_of
from lumitree.output.point_lights import PlacedLights

# Steps of the angles, degrees, and number of them in the mean side of a bin of a profile. Six
# would make it nine times larger.
_STEPS = (0.5, 0.75, 1, 1.5, 2, 2.5, 3, 5, 7.5, 10)
_STEPS_A_BIN = 2
LOST_COLOUR = "each light has the colour of its whole flux in all directions"


def light_distribution(
    name: str,
    intensity: NDArray[np.float64],
    lumens: float,
    rotation: NDArray[np.float64],
    steps: int,
) -> IntensityDistribution:
    """Luminous intensity of a light.

    Args:
        intensity: [R², 3] W/sr by octahedral bin.
        lumens: its flux, which the interpolated intensity has too.
        rotation: [3, 3], from the frame of the bins to one with y up.
        steps: least number of steps of the angles in the mean side of a bin.
    """
    resolution = round(len(intensity) ** 0.5)
    largest = np.degrees(np.sqrt(4 * np.pi) / resolution) / steps
    grid = Grid(max((step for step in _STEPS if step <= largest), default=_STEPS[0]))
    nodes = direction_of(grid.c[:, None], grid.gamma)
    bins, weights = bilinear_bins(nodes.reshape(-1, 3) @ rotation, resolution)
    values = (luminance(intensity)[bins] * weights).sum(axis=1).reshape(nodes.shape[:2])
    found = IntensityDistribution(name, grid.c, grid.gamma, values)
    factor = lumens / found.lumens if found.lumens > 0 else 1.0
    return IntensityDistribution(name, grid.c, grid.gamma, values * factor)


@dataclasses.dataclass(frozen=True, eq=False)
class ProfiledLight:
    """A point light in the frame of a program with y up.

    The intensity in a direction, in cd of each of R, G and B (683 times W/sr), is
    candela · colour · profile.

    Attributes:
        position: [3], m.
        candela: mean intensity over all directions, of the largest channel.
        colour: linear R, G and B; the largest is 1.
        profile: luminous intensity by direction, over its mean.
    """

    position: NDArray[np.float64]
    candela: float
    colour: RGB
    profile: IntensityDistribution


def profiled_lights(lights: PlacedLights, name: str) -> list[ProfiledLight]:
    """Lights with profiles (y up); channel by channel, each has the flux of its light."""
    found = []
    for index, watts in enumerate(lights.watts):
        intensity = lights.local.intensity[index]
        profile = light_distribution(
            f"{name} {index + 1}", intensity, 4 * np.pi, lights.rotation, _STEPS_A_BIN
        )
        red, green, blue = (watts / watts.max()).tolist()
        candela = LUMENS_PER_WATT * float(watts.max()) / (4 * np.pi)
        found.append(ProfiledLight(lights.position[index], candela, (red, green, blue), profile))
    return found
