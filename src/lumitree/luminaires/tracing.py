"""The integrator that traces a luminaire's paths, for everything that measures its light."""

from typing import Any

import numpy as np

from lumitree.core.backend import load_mitsuba
from lumitree.luminaires.luminaire import Luminaire

# Longest path: of opal glass, 8 % of the light takes more than 32 bounces.
PATH_DEPTH = 128


def path_integrator(luminaire: Luminaire, path_depth: int, **options: Any) -> Any:
    """The mi.Integrator that traces this luminaire's paths: `path` where there are no media.

    `volpath` samples distances by one channel's extinction, so that in coloured media the weights
    of the others have no bound; `volpathmis` weighs all three. But where media scatter that has
    rare paths that are not a number, and where they are grey it is only slower.

    Args:
        path_depth: longest path, bounces.
        options: more of the integrator's parameters, such as `rr_depth`.
    """
    kind = integrator_kind(luminaire)
    return load_mitsuba().load_dict({"type": kind, "max_depth": path_depth, **options})


def integrator_kind(luminaire: Luminaire) -> str:
    """Name of the Mitsuba integrator of `path_integrator`."""
    if not luminaire.has_media:
        return "path"
    return "volpathmis" if _only_colours(luminaire) else "volpath"


def _only_colours(luminaire: Luminaire) -> bool:
    """Whether some medium takes more of one channel than of another, and none scatters."""
    parameters = load_mitsuba().traverse(luminaire.scene)
    media = {"sigma_t": [], "albedo": []}
    for key, value in parameters:
        for name, values in media.items():
            if f".{name}." in key and "_medium." in key:
                values.append(np.ravel(value))
    coloured = any(np.ptp(extinction) > 0 for extinction in media["sigma_t"])
    return coloured and not any(albedo.max() > 0 for albedo in media["albedo"])
