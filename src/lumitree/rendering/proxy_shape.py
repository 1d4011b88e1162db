"""The proxy of a baked luminaire as a shape dictionary."""

import os
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_choice, check_gain
from lumitree.core.frames import similarity_scale
from lumitree.rendering.emitter_sampling import SAMPLING_KINDS, Sampling
from lumitree.rendering.opened import file_name, open_field
from lumitree.rendering.proxy import PROXY_KINDS, ProxyKind, make_proxy


class _Shape(dict[str, Any]):
    """A shape dictionary that keeps its field open, so that its plugins need not read it again."""

    field: Any


def describe_proxy(
    asset: Asset | str | os.PathLike[str],
    to_world: ArrayLike | Any | None = None,
    proxy: ProxyKind = "box",
    min_density: float = 0.0,
    max_opacity: float = 1.0,
    sampling: Sampling = "emission",
    gain: ArrayLike | Any = 1.0,
) -> dict[str, Any]:
    """Proxy shape with emitter and BSDF attached; arguments as for `lumitree.shape`."""
    check_choice("proxy", proxy, PROXY_KINDS)
    check_choice("sampling", sampling, SAMPLING_KINDS)
    factors = check_gain(gain)
    matrix = np.asarray(getattr(to_world, "matrix", np.eye(4) if to_world is None else to_world))
    if matrix.shape == (4, 4, 1):
        matrix = matrix[..., 0]
    similarity_scale(matrix, "to_world")
    field = open_field(asset, min_density, max_opacity)
    frame = field.asset.frame
    surface = make_proxy(proxy, frame.half_extents)
    scene_from_shape = matrix @ frame.world_from_local @ np.diag([*surface.shape_scale, 1])
    options = {
        "filename": file_name(asset),
        "to_world": mi.ScalarTransform4f(matrix),
        "proxy": proxy,
        "min_density": min_density,
        "max_opacity": max_opacity,
        "sampling": sampling,
    }
    description = _Shape(
        **surface.shape,
        to_world=mi.ScalarTransform4f(scene_from_shape),
        emitter={"type": "lumitree", "gain": list(factors), **options},
        bsdf={"type": "lumitree_null", **options},
    )
    description.field = field
    return description
