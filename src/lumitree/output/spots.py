"""Point lights as spots, which Blender's importers of glTF and OpenUSD take; they ignore profiles.

The importer of glTF makes 4 π I / 683 W of I candela (`calc_energy_pointlike` of io_scene_gltf2,
lighting mode "Standard"), and the importer of OpenUSD π times the intensity, which is 4 I for a
normalised sphere (`USDLightReader::read_object_data`): there I must be in W/sr.

Blender's spot with a blend of 1 has, at the angle θ to its axis, the intensity of a point light of
the same power times smoothstep((cos θ - cos α) / (1 - cos α)), where α is half its angle
(`spot_light_attenuation` of Cycles). A light is the sum of spots that is nearest to its intensity.
"""

import dataclasses
import math

import numpy as np
from numpy.typing import NDArray

from lumitree.core.octahedral import middle_directions, solid_angles
from lumitree.core.photometry import LUMENS_PER_WATT, RGB, luminance
from lumitree.output.point_lights import PlacedLights

# Halves of angles, degrees; Blender has none above 90. Axes: bins a side, and the brightest one.
_HALF_ANGLES, _AXES = (10.0, 20.0, 40.0, 90.0), 8
# Spots with a smaller part of the flux of their light are left out.
_SMALLEST = 0.005


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
        own = np.concatenate([axes, directions[[wanted.argmax()]]])
        shapes = np.concatenate([_shape(directions @ own.T, each) for each in _HALF_ANGLES], axis=1)
        # Flux of a spot over its intensity.
        size = np.repeat(np.pi * (1 - np.cos(np.radians(_HALF_ANGLES))), len(own))
        flux = nnls(shapes * root[:, None], wanted * root)[0] * size
        flux[flux < _SMALLEST * flux.sum()] = 0
        intensity = watts.max() * flux / flux.sum() / size
        red, green, blue = (watts / watts.max()).tolist()
        for spot in np.flatnonzero(flux):
            angle, axis = divmod(int(spot), len(own))
            found.append(
                Spot(
                    lights.position[index],
                    lights.rotation @ own[axis],
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
