"""Point lights with an IES profile each, or as spots for Blender's importers, without profiles.

**Profiles.** The frame of a light has z up: a profile's γ is the angle from -z, and its C the
azimuth from +x about z, counter-clockwise seen from +z. It is turned so that its z is the program's
y, which is up.

**Spots.** The importer of glTF makes 4 π I / 683 W of I candela (`calc_energy_pointlike` of
io_scene_gltf2, lighting mode "Standard"), and the importer of OpenUSD π times the intensity, which
is 4 I for a normalised sphere (`USDLightReader::read_object_data`): there I must be in W/sr.

Blender's spot with a blend of 1 has, at the angle θ to its axis, the intensity of a point light of
the same power times smoothstep((cos θ - cos α) / (1 - cos α)), where α is half its angle
(`spot_light_attenuation` of Cycles). A light is the sum of spots that is nearest to its intensity.

Symbols
    R   bins of direction a side, as in `exports.point_lights`
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lumitree.core.octahedral import bilinear_bins, middle_directions, solid_angles
from lumitree.core.photometry import LUMENS_PER_WATT, RGB, luminance
from lumitree.exports.point_lights import PlacedLights
from lumitree.formats.type_c import Grid, IntensityDistribution, direction_of

# Steps of the angles, degrees, and number of them in the mean side of a bin of a profile. Six
# would make it nine times larger.
_STEPS = (0.5, 0.75, 1, 1.5, 2, 2.5, 3, 5, 7.5, 10)
_STEPS_A_BIN = 2
LOST_COLOUR = "each light has the colour of its whole flux in all directions"
# Halves of angles, degrees; Blender has none above 90. Axes: bins a side, and the brightest one.
_HALF_ANGLES, _AXES = (10.0, 20.0, 40.0, 90.0), 8
# Spots with a smaller part of the flux of their light are dropped.
_SMALLEST = 0.005


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


@dataclasses.dataclass(frozen=True, eq=False)
class Spot:
    """A spot in the frame of a program.

    Attributes:
        position: [3], m.
        axis: [3] unit vector.
        half_angle: from the axis to the border, degrees.
        candela: intensity in the axis, of the largest channel.
        colour: linear R, G and B; the largest is 1.
    """

    position: NDArray[np.float64]
    axis: NDArray[np.float64]
    half_angle: float
    candela: float
    colour: RGB

    @property
    def rotation(self) -> list[float]:
        """Quaternion (x, y, z, w) from the frame of a spot, which emits along -z."""
        x, y, z = self.axis.tolist()
        w = math.sqrt(max((1 - z) / 2, 1e-12))
        return [y / (2 * w), -x / (2 * w), 0.0, w]


def spots_of(lights: PlacedLights) -> list[Spot]:
    """Spots with the flux of the lights, channel by channel."""
    from scipy.optimize import nnls

    resolution = lights.local.resolution
    directions, solid_angle = middle_directions(resolution), solid_angles(resolution)
    root, axes = np.sqrt(solid_angle), middle_directions(_AXES)
    found = []
    for index, watts in enumerate(lights.watts):
        wanted = luminance(lights.local.intensity[index])
        towards = np.concatenate([axes, directions[[wanted.argmax()]]])
        shapes = np.concatenate(
            [_shape(directions @ towards.T, each) for each in _HALF_ANGLES], axis=1
        )
        # Flux of a spot over its intensity.
        size = np.repeat(np.pi * (1 - np.cos(np.radians(_HALF_ANGLES))), len(towards))
        flux = nnls(shapes * root[:, None], wanted * root)[0] * size
        flux[flux < _SMALLEST * flux.sum()] = 0
        intensity = watts.max() * flux / flux.sum() / size
        red, green, blue = (watts / watts.max()).tolist()
        for spot in np.flatnonzero(flux):
            angle, axis = divmod(int(spot), len(towards))
            found.append(
                Spot(
                    lights.position[index],
                    lights.rotation @ towards[axis],
                    _HALF_ANGLES[angle],
                    LUMENS_PER_WATT * float(intensity[spot]),
                    (red, green, blue),
                )
            )
    return found


def _shape(cosine: NDArray[np.float64], half_angle: float) -> NDArray[np.float64]:
    """Intensity of a spot, relative to its axis."""
    border = math.cos(math.radians(half_angle))
    place = np.clip((cosine - border) / (1 - border), 0, 1)
    return place**2 * (3 - 2 * place)
