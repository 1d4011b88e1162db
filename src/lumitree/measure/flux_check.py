"""The flux of a luminaire by two methods, which every bake and evaluation compares.

Light paths are traced from the emitters, and everything that is baked comes from them. Camera paths
find emitters only by hitting them. A material or an emitter that one of both gets wrong shows as a
difference.
"""

import math
import warnings

import numpy as np

from lumitree.core.photometry import Flux, flux_text, luminance
from lumitree.core.results import Json
from lumitree.errors import LumitreeWarning
from lumitree.lamp.luminaire import Luminaire
from lumitree.measure.irradiance import CUBE_HALF_SIDE, NUM_CUBE_FACES, PATCHES, Irradiance
from lumitree.trace.flux import estimate_flux, flux_by_camera_paths

_CAMERA_PATHS = 1 << 20
# Before a difference is told both are estimated again, by other paths and more of them: one lamp in
# some hundreds differs by chance.
_AGAIN = 1 << 22
# Both differ if they do so by more standard errors than this, and by more than this part.
_ERRORS, _PART = 3, 0.02
# With fewer paths that hit an emitter the standard error is not known.
_FEWEST = 100


def check_flux(luminaire: Luminaire, explicit: Irradiance) -> Json:
    """Compare the flux by light paths with the flux by camera paths; warn where they differ.

    Args:
        explicit: irradiance of the luminaire by light paths, on a cube that all of them reach.

    Returns:
        `light_paths` and `camera_paths`, lm for lengths in metres, with the standard errors
        `light_paths_error` and `camera_paths_error`. The last two are None where too few
        camera paths hit an emitter.
    """
    patch = (2 * CUBE_HALF_SIDE / PATCHES * luminaire.frame.scale) ** 2
    lumens = patch * luminance(explicit.batches[:, :NUM_CUBE_FACES]).sum(axis=(1, 2, 3))
    light, light_error = float(lumens.mean()), float(lumens.std(ddof=1) / math.sqrt(len(lumens)))
    camera = flux_by_camera_paths(luminaire, _CAMERA_PATHS)
    known = camera.hits >= _FEWEST
    if known and _differ(light, light_error, camera):
        again = estimate_flux(luminaire, _AGAIN, seed=1)
        light, light_error = again.lumens, again.lumens_error
        camera = flux_by_camera_paths(luminaire, _AGAIN, seed=1)
    if known and _differ(light, light_error, camera):
        warnings.warn(
            f"{luminaire.name} emits {flux_text(light, light_error)} by light paths, but {camera} "
            "by camera paths that hit its emitters; one of both is wrong: look for surfaces that "
            "coincide, for materials that create light, and for glass that is not closed",
            LumitreeWarning,
            stacklevel=3,
        )
    return {
        "light_paths": light,
        "light_paths_error": light_error,
        "camera_paths": camera.lumens if known else None,
        "camera_paths_error": camera.lumens_error if known else None,
    }


def _differ(light: float, light_error: float, camera: Flux) -> bool:
    difference = abs(light - camera.lumens)
    error = np.hypot(light_error, camera.lumens_error)
    return difference > _ERRORS * error and difference > _PART * max(light, camera.lumens)
