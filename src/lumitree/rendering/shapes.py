"""The proxy of a baked luminaire as a shape dictionary, and its shapes in a scene."""

from __future__ import annotations

import os
from typing import Any

import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_gain
from lumitree.core.frames import similarity_scale
from lumitree.core.mitsuba_meshes import change_mesh, copy_mesh, hidden_mesh_class, mesh_arrays
from lumitree.lamp.media import media_of, scatters
from lumitree.rendering.asset_cache import file_name, open_asset
from lumitree.rendering.emitter import (
    GEOMETRY_MARGIN,
    Appearance,
    Sampling,
    check_kinds,
    shows_geometry,
)
from lumitree.rendering.geometry import geometry_shapes
from lumitree.rendering.objects import (
    load_ordered,
    make_object,
    medium_number,
    shape_number,
)


class _Shape(dict[str, Any]):
    """A shape dictionary that keeps its asset open, so that its plugins need not read it again."""

    asset: Asset


def describe_proxy(
    asset: Asset | str | os.PathLike[str],
    to_world: ArrayLike | Any | None = None,
    sampling: Sampling = "emission",
    gain: ArrayLike | Any = 1.0,
    appearance: Appearance | None = None,
) -> dict[str, Any]:
    """Implementation of `lumitree.shape`, with its arguments."""
    check_kinds(sampling, appearance or "field")
    factors = check_gain(gain)
    matrix = np.asarray(getattr(to_world, "matrix", np.eye(4) if to_world is None else to_world))
    if matrix.shape == (4, 4, 1):
        matrix = matrix[..., 0]
    similarity_scale(matrix, "to_world")
    opened = open_asset(asset)
    if appearance is None:
        appearance = "geometry" if opened.geometry is not None else "field"
    # In double precision for lamps that are far from the origin of their file.
    transform = mi.ScalarTransform4d if opened.frame.is_far else mi.ScalarTransform4f
    options = {
        "filename": file_name(asset),
        "to_world": transform(matrix),
        "sampling": sampling,
        "appearance": appearance,
    }
    if shows_geometry(opened, appearance):
        # One dictionary cannot describe several shapes; the plugin calls `make_shapes`.
        description = _Shape(type="lumitree_proxy", gain=list(factors), **options)
    else:
        description = _proxy(opened, matrix, 0.0, list(factors), options)
    description.asset = opened
    return description


def make_shapes(name: str, **options: Any) -> Any:
    """The mi.Shape of a proxy; or one shape that contains the proxy and the geometry's shapes.

    The ids of the geometry's shapes begin with `name`, the id of its proxy.
    """
    description = describe_proxy(**options)
    if description["type"] != "lumitree_proxy":
        return load_ordered(description)
    properties = {n: value for n, value in description.items() if n not in ("type", "gain")}
    asset = open_asset(properties["filename"])
    matrix = np.array(properties["to_world"].matrix, np.float64).reshape(4, 4)
    proxy = load_ordered(_proxy(asset, matrix, GEOMETRY_MARGIN, description["gain"], properties))
    lamp = proxy.emitter().lamp
    # The plugin `merge` expands into the shapes that it is given.
    shapes = geometry_shapes(matrix, lamp)
    lamp.shape_numbers += map(shape_number, shapes)
    lamp.medium_numbers += {medium_number(each) for each in media_of(shapes) if scatters(each)}
    together = {f"geometry_{index}": shape for index, shape in enumerate(shapes)}
    proxy.set_id(name)
    for key, shape in together.items():
        shape.set_id(f"{name}_{key}")
    return make_object("merge", {"proxy": proxy, **together})


def _proxy(
    asset: Asset,
    matrix: NDArray[np.float64],
    margin: float,
    gain: list[float],
    options: dict[str, object],
) -> _Shape:
    """The surface, larger than the box by a margin, with emitter and BSDF attached."""
    return _Shape(
        type="lumitree_box",
        to_world=_from_cube(asset, matrix, margin),
        emitter={"type": "lumitree", "gain": gain, **options},
        bsdf={"type": "lumitree_null", **options},
    )


def _from_cube(asset: Asset, matrix: NDArray[np.float64], margin: float) -> mi.ScalarTransform4f:
    """Transform of [-1, 1]³ to the surface of the proxy."""
    scale = np.diag([*(asset.frame.half_extents + margin), 1])
    return mi.ScalarTransform4f(matrix @ asset.frame.world_from_local @ scale)


def box_class() -> type:
    """Class of the shape for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeBox(hidden_mesh_class()):
        def __init__(self, props: mi.Properties) -> None:
            copy_mesh(self, make_object("cube", {"to_world": props["to_world"]}), props)
            self.shown = ("emitter",)

        def follow(self, scene_from_world: NDArray[np.float64]) -> None:
            """Move with its lamp."""
            lamp = self.emitter().lamp
            margin = GEOMETRY_MARGIN if lamp.shows_geometry else 0.0
            to_world = _from_cube(lamp.asset, scene_from_world, margin)
            change_mesh(self, mesh_arrays(make_object("cube", {"to_world": to_world})))
            self.bsdf().placed.place(scene_from_world)

        def to_string(self) -> str:
            return "LumitreeBox[]"

    return LumitreeBox
