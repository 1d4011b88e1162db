"""Reference: the flux of a luminaire by camera paths; import after `load_mitsuba`."""

import numpy as np

from lumitree.core.photometry import luminance
from lumitree.core.seeds import Purpose
from lumitree.trace import flux
from lumitree.trace.cameras import PATH_DEPTH, path_integrator


def flux_by_camera_paths(luminaire, num_paths, *, integrator=None, seed=0):
    """Flux by camera paths along rays that are uniform in position and direction.

    It is noisier than `estimate_flux`, independent of it, and too large by up to 6 % for small
    lamps of glass, see `trace.spawning`.

    Args:
        num_paths: rounded up to whole batches of 2**18.
        integrator: the integrator; by default the one that `path_integrator` makes.
    """
    integrator = integrator or path_integrator(luminaire, PATH_DEPTH)
    moments = flux.Moments(4)
    for batch_seed in flux.batch_seeds(num_paths, Purpose.LINES, seed):
        radiance = flux.random_radiance(luminaire, integrator, batch_seed)
        moments.add(np.column_stack([radiance, luminance(radiance)]), flux.BATCH)
    # Measure of all rays through the bounding sphere: 4π sr times its cross section, unit².
    radius = luminaire.bounding_radius * luminaire.frame.scale
    return flux.flux_of(moments, 4 * np.pi * np.pi * radius**2)
