"""The light field as a tensor and a description of its file, see docs/format.md.

The tensor is one zlib stream of all arrays, whose sizes are in the description. Most bins have
either straight or bent light, so the bent part of an intensity is stored only in bins that have
both, and a byte for each bin states which it has.
"""

import dataclasses
from collections.abc import Iterable

import numpy as np

from lumitree.asset.array_stream import Arrays, Layout, compressed, decompressed
from lumitree.asset.light_field import MAX_BINS, LightField, LightInside, TracedPaths
from lumitree.core.reading import Record
from lumitree.core.results import Json
from lumitree.errors import LumitreeError

_KEYS = ("depth", "resolution", "scale")
_TRACED_KEYS = ("count", "seeds", "luminaire", "noise")
# Members of the description with numbers of rows, and the array of each.
_ROWS = {"cells": "cells", "bins": "intensity", "divided": "bent"}
_INSIDE_ROWS = {
    **{"cells": "cells", "entries": "intensity", "divided": "bent"},
    **{"distances": "distances", "reach_curves": "reach_curves"},
}
# Before the names of arrays of the light inside.
_INSIDE = "inside."
# Which light a bin has: bent, straight, or both.
_BENT, _STRAIGHT, _BOTH = 0, 1, 2


def stored_light_field(field: LightField) -> tuple[Arrays, Json]:
    """Tensors of a field by name, and its description in the file."""
    arrays = _stored_arrays(field)
    description: Json = {key: getattr(field, key) for key in _KEYS}
    description |= {key: len(arrays[name]) for key, name in _ROWS.items()}
    layouts = layouts_of(description)
    if field.traced is not None:
        description["traced"] = dataclasses.asdict(field.traced)
    if (inside := field.inside) is not None:
        stored = _stored_arrays(inside)
        stored["bent_reach"] = inside.bent_reach - inside.reach
        counts = {key: len(stored[name]) for key, name in _INSIDE_ROWS.items()}
        description["inside"] = {**counts, "scale": inside.scale}
        layouts = layouts_of(description)
        arrays |= {_INSIDE + name: each for name, each in stored.items()}
    if field.absolute:
        description["absolute"] = True
    return {"light.stream": compressed(arrays, layouts)}, description


def build_light_field(description: Record, tensors: Arrays) -> LightField:
    """The field of a file; the inverse of `stored_light_field`."""
    description.expect_keys(*_KEYS, *_ROWS, optional=("traced", "inside", "absolute"))
    counts: Json = _counts(description, _ROWS) | {"resolution": description.integer("resolution")}
    described = description.record("inside") if description.has("inside") else None
    if described is not None:
        described.expect_keys(*_INSIDE_ROWS, "scale")
        counts["inside"] = _counts(described, _INSIDE_ROWS)
    arrays = decompressed(tensors["light.stream"], layouts_of(counts), "the light field")
    inside_arrays = {
        name.removeprefix(_INSIDE): arrays.pop(name)
        for name in list(arrays)
        if name.startswith(_INSIDE)
    }
    _restore_bent(arrays)
    inside = None
    if described is not None:
        _restore_bent(inside_arrays)
        inside_arrays["bent_reach"] += inside_arrays["reach"]
        inside = LightInside(**inside_arrays, scale=described.number("scale"))
    traced = None
    if description.has("traced"):
        paths = description.record("traced")
        paths.expect_keys(*_TRACED_KEYS)
        traced = TracedPaths(
            count=paths.integer("count"),
            seeds=tuple(paths.integers("seeds")),
            luminaire=paths.text("luminaire", 64),
            noise=None if paths.is_null("noise") else paths.number("noise"),
        )
    return LightField(
        **arrays,
        depth=description.integer("depth"),
        resolution=counts["resolution"],
        scale=description.number("scale"),
        traced=traced,
        inside=inside,
        absolute=description.has("absolute") and description.choice("absolute", (True,)),
    )


def layouts_of(description: Json) -> list[Layout]:
    """Arrays of a stream, in its order: of a field, and of the light inside if there is any."""
    cells, bins, divided = (description[key] for key in _ROWS)
    resolution = description["resolution"]
    found = [
        Layout("cells", np.uint8, (cells, 3)),
        Layout("lit", np.uint8, (cells, resolution**2 // 8)),
        Layout("intensity", np.uint32, (bins,)),
        Layout("kinds", np.uint8, (bins,)),
        Layout("bent", np.uint32, (divided,)),
    ]
    if "inside" not in description:
        return found
    cells, entries, divided, distances, curves = (description["inside"][k] for k in _INSIDE_ROWS)
    return [
        *found,
        Layout("inside.cells", np.uint8, (cells, 3)),
        Layout("inside.lit", np.uint8, (cells, -(-((resolution // 2) ** 2) // 8))),
        Layout("inside.intensity", np.uint32, (entries,)),
        Layout("inside.kinds", np.uint8, (entries,)),
        Layout("inside.bent", np.uint32, (divided,)),
        Layout("inside.reach", np.uint8, (entries,)),
        Layout("inside.bent_reach", np.uint8, (entries,)),
        Layout("inside.distances", np.float32, (distances,)),
        Layout("inside.reach_curves", np.float32, (curves, distances)),
    ]


def _counts(description: Record, keys: Iterable[str]) -> dict[str, int]:
    counts = {key: description.integer(key) for key in keys}
    for key, count in counts.items():
        if not 0 <= count <= MAX_BINS:
            raise LumitreeError(f"{key} {count}, expected 0 to {MAX_BINS}")
    return counts


def _stored_arrays(light: LightField | LightInside) -> Arrays:
    """The arrays of a light as a file has them: which light bins have, and the bent part."""
    straight = np.where(light.bent == 0, _STRAIGHT, _BOTH)
    kinds = np.where(light.bent == light.intensity, _BENT, straight).astype(np.uint8)
    return vars(light) | {"kinds": kinds, "bent": light.bent[kinds == _BOTH]}


def _restore_bent(arrays: Arrays) -> None:
    """Replace `kinds` and the stored bent part by the bent part of each bin."""
    kinds, stored = arrays.pop("kinds"), arrays["bent"]
    if (found := np.count_nonzero(kinds == _BOTH)) != len(stored) or (kinds > _BOTH).any():
        raise LumitreeError(f"{len(stored)} bent parts for {found} bins that have both")
    arrays["bent"] = np.where(kinds == _BENT, arrays["intensity"], np.uint32(0))
    arrays["bent"][kinds == _BOTH] = stored
