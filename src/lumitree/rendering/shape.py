"""`lumitree.shape`: a baked luminaire as a shape dictionary for `mitsuba.load_dict`."""

import os
from typing import Any

import numpy as np
from numpy.typing import ArrayLike

from lumitree.core.backend import load_mitsuba
from lumitree.core.frames import similarity_scale
from lumitree.errors import LumitreeError


class _Shape(dict[str, Any]):
    """A shape dictionary that keeps its field open, so that its plugins need not read it again."""

    field: Any


def shape(
    asset: str | os.PathLike[str],
    to_world: ArrayLike | Any | None = None,
    proxy: str = "box",
    min_density: float = 0.0,
    max_opacity: float = 1.0,
    sampling: str = "emission",
) -> dict[str, Any]:
    """Proxy shape with the `lumitree` emitter and the `lumitree_null` BSDF attached.

    Args:
        asset: path of a `.lumitree` file.
        to_world: [4, 4] matrix or Mitsuba transform that moves the luminaire from its own
            file's frame into the scene; rotation, translation and uniform scale. Default: stay.
        proxy: "box" or "sphere", the surface that carries the field.
        min_density: leaves below this density count as empty (the paper: 0.1).
        max_opacity: rays stop at this opacity (the paper: 0.9).
        sampling: "emission", about in proportion to it, or "uniform" over the proxy.

    Raises:
        LumitreeError: the asset cannot be read, or `to_world` shears or scales non-uniformly.
    """
    from lumitree.rendering.field import open_field
    from lumitree.rendering.plugins import register
    from lumitree.rendering.proxy import PROXY_KINDS, make_proxy
    from lumitree.rendering.emitter_sampling import SAMPLING_KINDS

    mi = load_mitsuba()
    register()
    if proxy not in PROXY_KINDS:
        raise LumitreeError(f"unknown proxy {proxy!r}; expected one of {', '.join(PROXY_KINDS)}")
    if sampling not in SAMPLING_KINDS:
        raise LumitreeError(
            f"unknown sampling {sampling!r}; expected one of {', '.join(SAMPLING_KINDS)}"
        )
    matrix = np.asarray(getattr(to_world, "matrix", np.eye(4) if to_world is None else to_world))
    if matrix.shape == (4, 4, 1):
        matrix = matrix[..., 0]
    similarity_scale(matrix, "to_world")
    field = open_field(asset, min_density, max_opacity)
    surface = make_proxy(proxy, field.asset.half_extents)
    scene_from_shape = matrix @ field.asset.world_from_proxy @ np.diag([*surface.shape_scale, 1])
    options = {
        "filename": str(asset),
        "to_world": mi.ScalarTransform4f(matrix),
        "proxy": proxy,
        "min_density": min_density,
        "max_opacity": max_opacity,
        "sampling": sampling,
    }
    description = _Shape(
        **surface.shape,
        to_world=mi.ScalarTransform4f(scene_from_shape),
        emitter={"type": "lumitree", **options},
        bsdf={"type": "lumitree_null", **options},
    )
    description.field = field
    return description
