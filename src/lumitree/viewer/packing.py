"""Content of the page of the viewer: arrays of an asset in one compressed stream.

The geometry is shown, if there is one (`model`), and the field. The field is rounded as in a
file, to the numbers of the file's stream (`field_file`). Without both the light field
is shown, as a field (`light_as_field`). The light field is reduced to luminous intensity, as
float16 relative to the largest of each cell.
"""

import base64
import dataclasses
from collections.abc import Collection
from typing import Any

import numpy as np

from lumitree.asset.array_stream import Arrays, Layout, compressed
from lumitree.asset.asset import Asset
from lumitree.asset.field_file import (
    BRIGHT,
    DENSITY_SHIFT,
    MEDIUM,
    STEPS,
    Steps,
    coefficient_codes,
    density_codes,
)
from lumitree.asset.light_field import LightField, unpack
from lumitree.core.photometry import luminance
from lumitree.core.results import Json
from lumitree.errors import LumitreeError
from lumitree.octree.build import wide_levels, wide_nodes
from lumitree.rendering.studio import BACKDROP, OWN, SOFTBOX, portrait_half_width, softboxes
from lumitree.viewer.light_as_field import DEFAULT_VIEW, brightest_view, light_as_field
from lumitree.viewer.model import page_model

# WebGL 2 textures of 4096 texels a row; GPUs in use have at least 8192 rows.
MAX_TEXELS = 4096 * 8192
# Steps of the coefficients of a light field shown as a field: its few leaves do not average errors.
_FINE_STEPS = Steps(1 / 16, 1 / 8, 1 / 8, 1 / 8)


@dataclasses.dataclass(frozen=True)
class PackedAsset:
    """An asset for the page.

    Attributes:
        description: numbers and names, for JSON; the key "arrays" has the name, type, rows and
            columns of each array of the stream, and whether it is in planes.
        block: the stream (`array_stream`), in base64.
    """

    description: Json
    block: str


def pack_asset(asset: Asset) -> PackedAsset:
    """Convert an asset for the page; refuses one too large for textures of WebGL 2."""
    arrays: Arrays = {}
    has_field, view = asset.num_leaves > 0, DEFAULT_VIEW
    model = field = light = None
    texels = [0]
    if asset.geometry is not None:
        made = page_model(asset)
        model, arrays = made.description, made.arrays
        texels += [2 * len(arrays["positions"]), len(arrays["triangles"])]
    if has_field or model is None:
        steps, whole = STEPS, asset
        if not has_field:
            steps, whole, view = _FINE_STEPS, light_as_field(asset), brightest_view(asset)
        field, of_field = _field(whole, steps)
        arrays |= of_field
        texels += [of_field["nodes"].size, of_field["coefficients"].size // 3]
    in_planes = set(arrays)
    if asset.light_field is not None:
        light = {"depth": asset.light_field.depth, "resolution": asset.light_field.resolution}
        arrays |= _light_field_arrays(asset.light_field, asset.light_factors)
        texels.append(asset.light_field.lit.size * 8)
    if max(texels) > MAX_TEXELS:
        raise LumitreeError(
            f"the asset of {asset.luminaire} has {max(texels):,} texels; the viewer shows at most "
            f"{MAX_TEXELS:,}; bake it with a lower quality"
        )
    described, block = packed_arrays(arrays, in_planes)
    # Subjects of the page's images.
    subjects = ["model"] * (model is not None) + ["field"] * has_field
    shown = " and ".join(subjects) or "light field"
    description = {
        "luminaire": asset.luminaire,
        "bytes": asset.num_bytes,
        "shown": shown,
        "has_field": has_field,
        "view": view,
        "half_extents": asset.frame.half_extents.tolist(),
        "scale": float(asset.frame.scale),
        "studio": {
            "backdrop": BACKDROP,
            "own": OWN,
            "softbox": SOFTBOX,
            # Columns of each: half of two sides, direction of the light and middle.
            "softboxes": [
                box[:3].T.ravel().tolist() for box in softboxes(portrait_half_width(asset))
            ],
        },
        "field": field,
        "model": model,
        "light_field": light,
        "arrays": described,
    }
    return PackedAsset(description, block)


def packed_arrays(arrays: Arrays, in_planes: Collection[str]) -> tuple[list[Any], str]:
    """Arrays for a page: name, type, rows, columns and planes of each; and the stream, in base64.

    Args:
        in_planes: names of the arrays that are written in planes.
    """
    layouts = [
        Layout(name, array.dtype, array.shape, planes=name in in_planes)
        for name, array in arrays.items()
    ]
    kinds = [np.dtype(each.dtype).str.lstrip("<|") for each in layouts]
    described = [
        [each.name, kind, len(array), array[:1].size, each.planes]
        for each, kind, array in zip(layouts, kinds, arrays.values(), strict=True)
    ]
    return described, base64.b64encode(compressed(arrays, layouts).tobytes()).decode()


def _field(asset: Asset, steps: Steps) -> tuple[Json, Arrays]:
    levels = wide_nodes(asset.children, asset.tree_depth)
    starts = np.concatenate([[0], np.cumsum([level.size for level in levels])])
    arrays: Arrays = {
        "nodes": np.concatenate(levels),
        "density": density_codes(asset.density),
        # One texel of R, G and B for each coefficient.
        "coefficients": coefficient_codes(asset.coefficients, steps).reshape(asset.num_leaves, -1),
    }
    description = {
        "law": asset.law,
        "l_max": asset.l_max,
        "tree_depth": asset.tree_depth,
        "leaves": asset.num_leaves,
        "max_radiance": asset.max_radiance * max(asset.light_factors),
        "colour": [factor / max(asset.light_factors) for factor in asset.light_factors],
        "level_bits": wide_levels(asset.tree_depth),
        "level_starts": starts[:-1].tolist(),
        "density_shift": DENSITY_SHIFT,
        "steps": [*steps, BRIGHT, MEDIUM],
    }
    return description, arrays


def _light_field_arrays(field: LightField, factors: tuple[float, float, float]) -> Arrays:
    """Luminous intensity of the bins that emit, in cd for local units of 1 m, and their cells."""
    luminous = luminance(unpack(field.intensity) * field.scale * np.array(factors))
    counts = np.bitwise_count(field.lit).sum(axis=1, dtype=np.int64)
    starts = np.concatenate([[0], np.cumsum(counts)[:-1]])
    largest = np.maximum.reduceat(luminous, starts)
    divisor = np.repeat(np.where(largest > 0, largest, 1), counts)
    return {
        "cells": field.cells.ravel(),
        "lit": field.lit.ravel(),
        "cell_scale": largest.astype(np.float32),
        "intensity": (luminous / divisor).astype(np.float16),
    }
