"""The integrator that traces a luminaire's paths, for everything that measures its light."""

from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeError
from lumitree.lamp.luminaire import Luminaire
from lumitree.lamp.media import is_coloured, media

# Longest path: of opal glass, 8 % of the light takes more than 32 bounces.
PATH_DEPTH = 128


def path_integrator(luminaire: Luminaire, path_depth: int, **options: Any) -> Any:
    """The mi.Integrator that traces this luminaire's paths.

    `path` where there are neither media, alpha masks nor null surfaces. Its next-event estimation
    takes these for opaque: the light of a spot light in their shade would be found by chance alone.
    And it counts no light of rays that meet nothing else.

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
        return "volpath" if any(map(_is_passed, luminaire.scene.shapes())) else "path"
    only_colours = not luminaire.scatters and any(map(is_coloured, media(luminaire.scene)))
    return "volpathmis" if only_colours else "volpath"


def _is_passed(shape: Any) -> bool:
    """Whether light may pass a shape as if it were not there."""
    mi, bsdf = load_mitsuba(), shape.bsdf()
    # Thin glass, which Mitsuba counts among these, is lit as glass is.
    return mi.has_flag(bsdf.flags(), mi.BSDFFlags.Null) and bsdf.class_name() != "ThinDielectric"


def check_finite(luminaire: Luminaire, values: NDArray[np.floating]) -> None:
    """Refuse traced radiance that is NaN or infinite."""
    if not np.isfinite(values).all():
        raise LumitreeError(
            f"{luminaire.name} renders as NaN or infinity; look for materials or emitters with "
            "invalid values"
        )
