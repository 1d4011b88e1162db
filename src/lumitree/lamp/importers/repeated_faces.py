"""Faces that a model has more than once in one place, as copies of an object: each counts once.

Every copy would emit and absorb light of its own.
"""

import dataclasses
import warnings
from collections import defaultdict
from collections.abc import Collection, Sequence

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeWarning, shown
from lumitree.lamp.importers.mesh_faces import selected, with_backs
from lumitree.lamp.importers.topology import Indices, reach, repeats, weld
from lumitree.lamp.meshes import Floats, Mesh, area_normals
from lumitree.lamp.names import Names
from lumitree.lamp.parts import Geometry, Part

# Largest difference of two surfaces that are the same, as a fraction of the area: quads may not be
# flat.
_ALIKE = 0.01
# Most copies of different surfaces in one box that others are compared with.
_COMPARED = 8


def kept_faces(
    corners: Floats, within: float, sided: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which faces [F] are used, and which of these [F] need a reversed copy.

    `corners` and `within` are as in `repeats`. If the two sides of the material differ, both
    windings of a face are used, the second as a copy of the first.
    """
    first, turned = repeats(corners, within)
    both = np.zeros(len(first), np.bool_)
    both[first[turned & sided]] = True
    return first == np.arange(len(first)), both


def with_reversed(mesh: Mesh, both: NDArray[np.bool_], within: float) -> Mesh:
    """The mesh with the reversed copies that `kept_faces` asks for."""
    # Farther than one face from another, so that they are not taken for one.
    return with_backs(mesh, both, 2 * within) if both.any() else mesh


def warn_of_repeated(file: str, count: int) -> None:
    """Say how many faces of a model are not used, if there are any."""
    if count:
        warnings.warn(
            f"{shown(file, 300)}: {count:,} faces repeat others of the same material in the same "
            "place; each is used once",
            LumitreeWarning,
            stacklevel=3,
        )


def without_repeated(model: Geometry, sided: Collection[str], file: str) -> Geometry:
    """The model with every face once, also where copies of parts are in one place.

    `sided` are the titles of the materials whose two sides differ, such as those that emit.
    """
    title = {material.name: material.title for material in model.materials}
    copies: dict[str, list[tuple[Part, int]]] = defaultdict(list)
    for part in model.parts:
        copies[title[part.material]] += [(part, at) for at in range(len(part.places))]
    used: dict[tuple[str, int], tuple[NDArray[np.bool_], NDArray[np.bool_]]] = {}
    within, dropped = {}, 0
    for name, own in copies.items():
        placed = [_placed(part, at) for part, at in own]
        within[name] = reach(np.concatenate([vertices for vertices, _ in placed]))
        twice = _repeated_surfaces(placed, within[name], name in sided)
        single = [copy[0][copy[1]] for copy, again in zip(placed, twice, strict=True) if not again]
        keep, both = kept_faces(np.concatenate(single), within[name], name in sided)
        dropped += int((~keep).sum() - both.sum())
        ends = np.cumsum([len(corners) for corners in single])[:-1]
        masks = iter(zip(np.split(keep, ends), np.split(both, ends), strict=True))
        for (part, at), again in zip(own, twice, strict=True):
            nothing = np.zeros(len(part.mesh.faces), np.bool_)
            used[part.name, at] = (nothing, nothing) if again else next(masks)
            dropped += len(nothing) * again
    warn_of_repeated(file, dropped)
    names, parts = Names("_"), []
    for part in model.parts:
        names.unique(part.name)
    for part in model.parts:
        alike: dict[bytes, list[int]] = defaultdict(list)
        for at in range(len(part.places)):
            alike[np.stack(used[part.name, at]).tobytes()].append(at)
        name = part.name
        for places in alike.values():
            keep, both = used[part.name, places[0]]
            if keep.any():
                scale = np.cbrt(abs(np.linalg.det(part.places[places[0]][:3, :3])))
                mesh = with_reversed(part.mesh, both, within[title[part.material]] / scale)
                if not keep.all():
                    mesh = selected(mesh, np.concatenate([keep, np.ones(both.sum(), np.bool_)]))
                parts.append(dataclasses.replace(part.copies(places), name=name, mesh=mesh))
                name = names.unique(part.name)
    return dataclasses.replace(model, parts=tuple(parts))


def _placed(part: Part, at: int) -> tuple[Floats, Indices]:
    """Vertices [V, 3] of a copy, in the model's frame, and its faces."""
    place = part.places[at]
    return part.mesh.vertices @ place[:3, :3].T + place[:3, 3], part.mesh.faces


def _repeated_surfaces(
    copies: Sequence[tuple[Floats, Indices]], within: float, sided: bool
) -> list[bool]:
    """Which copies (vertices [V, 3], faces) are the surface of an earlier one, cut in any way.

    An example is a sphere and its mirror image, whose quads have the other diagonal.
    """
    # Boxes, whose corners are in the same places.
    low, high = (
        weld(np.stack([end(vertices, axis=0) for vertices, _ in copies]), within)
        for end in (np.min, np.max)
    )
    earlier: dict[tuple[int, int], list[int]] = defaultdict(list)
    repeated = []
    for at, (copy, *box) in enumerate(zip(copies, low.tolist(), high.tolist(), strict=True)):
        others = earlier[box[0], box[1]]
        sides = [_side(copies[other], copy, within) for other in others[:_COMPARED]]
        repeated.append(any(side == 1 or (side == -1 and not sided) for side in sides))
        if not repeated[-1]:
            others.append(at)
    return repeated


def _side(one: tuple[Floats, Indices], other: tuple[Floats, Indices], within: float) -> int:
    """1 where two surfaces are the same, -1 where one is the other turned round, 0 otherwise.

    The same surfaces have vertices in the same places, and the same areas by their normals.
    """
    split = len(one[0])
    places = weld(np.concatenate([one[0], other[0]]), within)
    count = int(places.max()) + 1
    fields, moments = [], []
    for (vertices, faces), own in zip((one, other), np.split(places, [split]), strict=True):
        if len(np.unique(own)) < count:
            return 0
        normals = area_normals(vertices, faces)
        corners = own[faces].ravel()
        fields.append([np.bincount(corners, np.repeat(axis, 3), count) for axis in normals.T])
        lengths = np.maximum(np.linalg.norm(normals, axis=1), 1e-300)
        moments.append((normals / lengths[:, None]).T @ normals)
    if np.abs(moments[1] - moments[0]).max() > _ALIKE * np.trace(moments[0]):
        return 0
    return int(np.sign((np.array(fields[0]) * np.array(fields[1])).sum()))
