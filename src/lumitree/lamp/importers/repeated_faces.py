"""Faces that a model has more than once in one place, as copies of an object: each counts once.

Every copy would emit and absorb light of its own.
"""

import dataclasses
import warnings
from collections import defaultdict
from collections.abc import Collection

import numpy as np
from numpy.typing import NDArray

from lumitree.errors import LumitreeWarning, shown
from lumitree.lamp.importers.mesh_faces import selected, with_backs
from lumitree.lamp.importers.topology import reach, repeats
from lumitree.lamp.meshes import Floats, Mesh
from lumitree.lamp.names import Names
from lumitree.lamp.parts import Geometry, Part


def kept_faces(
    corners: Floats, within: float, sided: bool
) -> tuple[NDArray[np.bool_], NDArray[np.bool_]]:
    """Which faces [F] are used, and which of these [F] need a reversed copy.

    Args:
        corners, within: as of `repeats`.
        sided: the two sides of the material differ: of a face in both windings both are used, the
            second as a copy of the first.
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

    Args:
        sided: titles of the materials whose two sides differ, as those that emit.
        file: name of the model's file, for a warning.
    """
    title = {material.name: material.title for material in model.materials}
    copies: dict[str, list[tuple[Part, int]]] = defaultdict(list)
    for part in model.parts:
        copies[title[part.material]] += [(part, at) for at in range(len(part.places))]
    used: dict[tuple[str, int], tuple[NDArray[np.bool_], NDArray[np.bool_]]] = {}
    within, dropped = {}, 0
    for name, own in copies.items():
        corners = np.concatenate([_corners(part, at) for part, at in own])
        within[name] = reach(corners)
        keep, both = kept_faces(corners, within[name], name in sided)
        dropped += int((~keep).sum() - both.sum())
        ends = np.cumsum([len(part.mesh.faces) for part, _ in own])[:-1]
        for (part, at), *masks in zip(own, np.split(keep, ends), np.split(both, ends), strict=True):
            used[part.name, at] = (masks[0], masks[1])
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


def _corners(part: Part, at: int) -> Floats:
    """Corners [F, 3, 3] of the triangles of a copy, in the model's frame."""
    place = part.places[at]
    return (part.mesh.vertices @ place[:3, :3].T + place[:3, 3])[part.mesh.faces]
