"""The light field as a tensor and a description of its file, see docs/format.md.

The tensor is one zlib stream of all arrays, whose sizes are in the description. Most bins have
either straight or bent light, so the bent part of an intensity is stored only in bins that have
both, and a byte for each bin states which it has.
"""

import dataclasses
from typing import Annotated

import numpy as np

from lumitree.asset.array_stream import Arrays, Layout, compressed, decompressed
from lumitree.asset.light_field import MAX_BINS, LightField, LightInside, Outline, TracedPaths
from lumitree.core.results import Json
from lumitree.core.tables import Range
from lumitree.errors import LumitreeError

_Count = Annotated[int, Range(0, MAX_BINS)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class _InsideSizes:
    cells: _Count
    entries: _Count
    divided: _Count
    distances: _Count
    reach_curves: _Count
    scale: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class LightDescription:
    """Sizes and other members of a light field in the description of its file.

    Attributes:
        bins: number of the bins that emit.
        divided: number of the bins with straight and bent light.
    """

    depth: int
    resolution: int
    scale: float
    cells: _Count
    bins: _Count
    divided: _Count
    traced: TracedPaths | None = None
    inside: _InsideSizes | None = None
    absolute: bool = False
    outline: Outline | None = None


# Before the names of arrays of the light inside.
_INSIDE = "inside."
# Which light a bin has: bent, straight, or both.
_BENT, _STRAIGHT, _BOTH = 0, 1, 2


def stored_light_field(field: LightField) -> tuple[Arrays, Json]:
    """Tensors of a field by name, and its description in the file."""
    arrays, sizes = _stored_arrays(field), None
    if (inside := field.inside) is not None:
        stored = _stored_arrays(inside)
        stored["bent_reach"] = inside.bent_reach - inside.reach
        sizes = _InsideSizes(
            cells=len(inside.cells),
            entries=len(inside.intensity),
            divided=len(stored["bent"]),
            distances=len(inside.distances),
            reach_curves=len(inside.reach_curves),
            scale=inside.scale,
        )
        arrays |= {_INSIDE + name: each for name, each in stored.items()}
    description = LightDescription(
        depth=field.depth,
        resolution=field.resolution,
        scale=field.scale,
        cells=len(field.cells),
        bins=len(field.intensity),
        divided=len(arrays["bent"]),
        traced=field.traced,
        inside=sizes,
        absolute=field.absolute,
        outline=field.outline,
    )
    members = dataclasses.asdict(description)
    for name in ("traced", "inside", "absolute", "outline"):
        if not members[name]:
            del members[name]
    return {"light.stream": compressed(arrays, layouts_of(description))}, members


def build_light_field(description: LightDescription, tensors: Arrays) -> LightField:
    """The field of a file; the inverse of `stored_light_field`."""
    arrays = decompressed(tensors["light.stream"], layouts_of(description), "the light field")
    inside_arrays = {
        name.removeprefix(_INSIDE): arrays.pop(name)
        for name in list(arrays)
        if name.startswith(_INSIDE)
    }
    _restore_bent(arrays)
    inside = None
    if description.inside is not None:
        _restore_bent(inside_arrays)
        inside_arrays["bent_reach"] += inside_arrays["reach"]
        inside = LightInside(**inside_arrays, scale=description.inside.scale)
    return LightField(
        **arrays,
        depth=description.depth,
        resolution=description.resolution,
        scale=description.scale,
        traced=description.traced,
        inside=inside,
        absolute=description.absolute,
        outline=description.outline,
    )


def layouts_of(description: LightDescription) -> list[Layout]:
    """Arrays of a stream, in its order: of a field, and of the light inside if there is any."""
    bins, resolution = description.bins, description.resolution
    found = [
        Layout("cells", np.uint8, (description.cells, 3)),
        Layout("lit", np.uint8, (description.cells, resolution**2 // 8)),
        Layout("intensity", np.uint32, (bins,)),
        Layout("kinds", np.uint8, (bins,)),
        Layout("bent", np.uint32, (description.divided,)),
    ]
    if (sizes := description.inside) is None:
        return found
    cells, entries = sizes.cells, sizes.entries
    return [
        *found,
        Layout("inside.cells", np.uint8, (cells, 3)),
        Layout("inside.lit", np.uint8, (cells, -(-((resolution // 2) ** 2) // 8))),
        Layout("inside.intensity", np.uint32, (entries,)),
        Layout("inside.kinds", np.uint8, (entries,)),
        Layout("inside.bent", np.uint32, (sizes.divided,)),
        Layout("inside.reach", np.uint8, (entries,)),
        Layout("inside.bent_reach", np.uint8, (entries,)),
        Layout("inside.distances", np.float32, (sizes.distances,)),
        Layout("inside.reach_curves", np.float32, (sizes.reach_curves, sizes.distances)),
    ]


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
