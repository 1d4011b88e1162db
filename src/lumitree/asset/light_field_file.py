"""The light field as a tensor and a description of its file, see docs/format.md.

The tensor is one zlib stream of all arrays, whose sizes are in the description. Most bins have
either straight or bent light, so the bent part of an intensity is stored only in bins that have
both, and a byte for each bin states which it has.
"""

import dataclasses
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.array_stream import Arrays, Layout, compressed, decompressed
from lumitree.asset.light_field import MAX_BINS, LightField, LightInside, TracedPaths
from lumitree.core.reading import Record
from lumitree.core.results import Json
from lumitree.errors import LumitreeError

_KEYS = ("depth", "resolution", "scale")
_TRACED_KEYS = ("count", "seeds", "luminaire", "noise")
# Numbers of rows of the arrays.
_COUNTS = ("cells", "bins", "divided")
_INSIDE_COUNTS = ("cells", "entries", "divided", "distances", "reach_curves")
# Before the names of arrays of the light inside.
_INSIDE = "inside."
# Which light a bin has: bent, straight, or both.
_BENT, _STRAIGHT, _BOTH = 0, 1, 2


def light_field_tensors(field: LightField) -> Arrays:
    """Tensors of a field, by name."""
    outer, inner = _layouts(_counts(field), field.resolution)
    arrays = vars(field) | _stored_parts(field)
    if (inside := field.inside) is not None:
        stored = vars(inside) | _stored_parts(inside)
        stored["bent_reach"] = inside.bent_reach - inside.reach
        arrays |= {_INSIDE + name: each for name, each in stored.items()}
    return {"light.stream": compressed(arrays, outer + inner)}


def light_field_description(field: LightField) -> Json:
    """Description of a field in the file, besides its tensors."""
    counts, inside = _counts(field)
    members: Json = {key: getattr(field, key) for key in _KEYS} | counts
    if field.traced is not None:
        members["traced"] = dataclasses.asdict(field.traced)
    if field.inside is not None:
        members["inside"] = {**inside, "scale": field.inside.scale}
    if field.absolute:
        members["absolute"] = True
    return members


def build_light_field(description: Record, tensors: Arrays) -> LightField:
    """The field of a file; the inverse of `light_field_tensors` and `light_field_description`."""
    description.expect_keys(*_KEYS, *_COUNTS, optional=("traced", "inside", "absolute"))
    resolution = description.integer("resolution")
    described, inside_counts = None, {}
    if description.has("inside"):
        described = description.record("inside")
        described.expect_keys(*_INSIDE_COUNTS, "scale")
        inside_counts = _read_counts(described, _INSIDE_COUNTS)
    outer, inner = _layouts((_read_counts(description, _COUNTS), inside_counts), resolution)
    arrays = decompressed(tensors["light.stream"], outer + inner, "the light field")
    inside_arrays = {each.name.removeprefix(_INSIDE): arrays.pop(each.name) for each in inner}
    _restore_bent(arrays)
    inside = None
    if described is not None:
        _restore_bent(inside_arrays)
        inside_arrays["bent_reach"] += inside_arrays["reach"]
        inside = LightInside(**inside_arrays, scale=described.number("scale"))
    traced = _build_traced(description.record("traced")) if description.has("traced") else None
    return LightField(
        **arrays,
        depth=description.integer("depth"),
        resolution=resolution,
        scale=description.number("scale"),
        traced=traced,
        inside=inside,
        absolute=description.has("absolute") and description.choice("absolute", (True,)),
    )


def _build_traced(description: Record) -> TracedPaths:
    description.expect_keys(*_TRACED_KEYS)
    return TracedPaths(
        count=description.integer("count"),
        seeds=tuple(description.integers("seeds")),
        luminaire=description.text("luminaire", 64),
        noise=None if description.is_null("noise") else description.number("noise"),
    )


def _counts(field: LightField) -> tuple[dict[str, int], dict[str, int]]:
    """Numbers of rows of the arrays of a field, and of its light inside the box, if it has any."""
    outer = {
        "cells": len(field.cells),
        "bins": len(field.intensity),
        "divided": int(np.count_nonzero(_light_of_bins(field) == _BOTH)),
    }
    if (inside := field.inside) is None:
        return outer, {}
    return outer, {
        "cells": len(inside.cells),
        "entries": len(inside.intensity),
        "divided": int(np.count_nonzero(_light_of_bins(inside) == _BOTH)),
        "distances": len(inside.distances),
        "reach_curves": len(inside.reach_curves),
    }


def _light_of_bins(light: LightField | LightInside) -> NDArray[np.uint8]:
    """Which light each bin has."""
    found = np.where(light.bent == 0, _STRAIGHT, _BOTH)
    return np.where(light.bent == light.intensity, _BENT, found).astype(np.uint8)


def _stored_parts(light: LightField | LightInside) -> Arrays:
    """The bent part of an intensity, as a file has it."""
    kinds = _light_of_bins(light)
    return {"kinds": kinds, "bent": light.bent[kinds == _BOTH]}


def _restore_bent(arrays: Arrays) -> None:
    """Replace the arrays of `_stored_parts` by the bent part of each bin."""
    kinds, stored = arrays.pop("kinds"), arrays["bent"]
    if (found := np.count_nonzero(kinds == _BOTH)) != len(stored) or (kinds > _BOTH).any():
        raise LumitreeError(f"{len(stored)} bent parts for {found} bins that have both")
    arrays["bent"] = np.where(kinds == _BENT, arrays["intensity"], np.uint32(0))
    arrays["bent"][kinds == _BOTH] = stored


def _read_counts(description: Record, keys: tuple[str, ...]) -> dict[str, int]:
    counts = {key: description.integer(key) for key in keys}
    for key, count in counts.items():
        if not 0 <= count <= MAX_BINS:
            raise LumitreeError(f"{key} {count}, expected 0 to {MAX_BINS}")
    return counts


def _layouts(
    counts: tuple[dict[str, int], dict[str, int]], resolution: int
) -> tuple[list[Layout], list[Layout]]:
    """Arrays of a stream, in its order: of a field, and of the light inside."""
    counts_outer, counts_inner = counts
    outer = [
        Layout("cells", np.uint8, (counts_outer["cells"], 3)),
        Layout("lit", np.uint8, (counts_outer["cells"], resolution**2 // 8)),
        Layout("intensity", np.uint32, (counts_outer["bins"],)),
        Layout("kinds", np.uint8, (counts_outer["bins"],)),
        Layout("bent", np.uint32, (counts_outer["divided"],)),
    ]
    if not counts_inner:
        return outer, []
    cells, entries, divided, distances, curves = (counts_inner[key] for key in _INSIDE_COUNTS)
    inner: list[tuple[str, Any, tuple[int, ...]]] = [
        ("cells", np.uint8, (cells, 3)),
        ("lit", np.uint8, (cells, -(-((resolution // 2) ** 2) // 8))),
        ("intensity", np.uint32, (entries,)),
        ("kinds", np.uint8, (entries,)),
        ("bent", np.uint32, (divided,)),
        ("reach", np.uint8, (entries,)),
        ("bent_reach", np.uint8, (entries,)),
        ("distances", np.float32, (distances,)),
        ("reach_curves", np.float32, (curves, distances)),
    ]
    return outer, [Layout(_INSIDE + name, dtype, shape) for name, dtype, shape in inner]
