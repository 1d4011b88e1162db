"""The light of a lamp that its own rough surfaces reflect, from the field (decision 64)."""

from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.rendering.placed import Placed


def reflected_light(placed: Placed) -> Callable[[Any, Any], Any] | None:
    """Function that returns the lamp's own light at an interaction (mi.Color3f), or None.

    It is None for an asset without a field: paths then have to find the light.
    """
    field = placed.field
    if not placed.asset.num_leaves:
        return None

    def reflected(si: Any, active: Any) -> Any:
        line = placed.local_line(si.p, -si.to_world(si.wi))
        return dr.select(active, field.emission_near(*line, active), mi.Color3f(0))

    return reflected
