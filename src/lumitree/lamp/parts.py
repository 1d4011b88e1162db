"""A lamp as parts and materials, independent of the file format that it was read from.

Frame: right-handed, y up unless the file says otherwise; lengths in the lamp's own unit. Names of
parts and materials are unique, and patterns choose by them.
"""

import dataclasses
import fnmatch
import functools
import re
from collections.abc import Sequence

import numpy as np

from lumitree.asset.materials import Image
from lumitree.errors import LumitreeError, shown, shown_names
from lumitree.lamp.materials import Material
from lumitree.lamp.meshes import Floats, Mesh

# Loading a shape takes milliseconds, however few triangles it has.
MAX_SHAPES = 5000
# A pattern of digits alone; a name of this form is matched by "[#]3".
_NUMBER = re.compile(r"#[0-9]{1,9}")


@dataclasses.dataclass(frozen=True)
class Part:
    """A mesh with its material, in one or more places.

    Attributes:
        name: unique in the lamp; also the name of the mesh file.
        mesh: in the part's own frame.
        material: name of a material.
        places: `world_from_part` [4, 4] of every copy.
        objects: of every copy, the name of the object in the model's file; () where objects have
            the name of the part.
        in_metres: whether the mesh is in metres, whatever the unit of the model is.
    """

    name: str
    mesh: Mesh
    material: str
    places: tuple[Floats, ...] = (np.eye(4),)
    objects: tuple[str, ...] = ()
    in_metres: bool = False

    def copies(self, index: Sequence[int]) -> "Part":
        """The part with some of its copies."""
        places, objects = (tuple(v[i] for i in index if v) for v in (self.places, self.objects))
        return dataclasses.replace(self, places=places, objects=objects)

    def placed(self, copy: int) -> Floats:
        """Vertices [V, 3] of a copy, in the model's frame."""
        place = self.places[copy]
        return self.mesh.vertices @ place[:3, :3].T + place[:3, 3]


def check_shapes(count: int, where: str) -> None:
    """Refuse more than `MAX_SHAPES` shapes, one for each place of each part, in `where`."""
    if count > MAX_SHAPES:
        raise LumitreeError(
            f"{where} brings the model to {count} shapes; at most {MAX_SHAPES} are read: join "
            "meshes of one material"
        )


@dataclasses.dataclass(frozen=True, eq=False)
class Geometry:
    """A lamp: its parts, the materials they name, and the images of textures.

    `images` are as of `AssetGeometry`: float32 where values may exceed 1, as for emission.
    """

    parts: tuple[Part, ...]
    materials: tuple[Material, ...]
    images: tuple[Image, ...] = ()

    def material(self, part: Part) -> Material:
        """The material of a part."""
        return self._materials[part.material]

    @functools.cached_property
    def _materials(self) -> dict[str, Material]:
        return {material.name: material for material in self.materials}


class Names:
    """Makes names that are unique, also where upper and lower case are not distinguished."""

    def __init__(self, separator: str) -> None:
        self._separator = separator
        self._taken: set[str] = set()
        self._numbers: dict[str, int] = {}

    def unique(self, wanted: str) -> str:
        """`wanted`, with a number where it is taken."""
        key = wanted.lower()
        name, number = wanted, self._numbers.get(key, 1)
        while name.lower() in self._taken:
            number += 1
            name = f"{wanted}{self._separator}{number}"
        # The next search starts here: from 1, many equal names would take quadratic time.
        self._numbers[key] = number
        self._taken.add(name.lower())
        return name


def select_names(
    names: Sequence[Sequence[str]],
    keep: Sequence[str],
    drop: Sequence[str],
    file: str,
    kind: str,
    listed: Sequence[str] | None = None,
) -> list[bool]:
    """Which things are kept, each known by one or more names; patterns must match something."""
    how = "" if listed is None else f"; 'lumitree preview {file} --keep \"*\"' lists them all"
    kept, dropped = (
        [matching(each, option, names, file, kind, listed, how) for each in patterns]
        for option, patterns in (("--keep", keep), ("--drop", drop))
    )
    chosen = [
        (not keep or any(each[at] for each in kept)) and not any(each[at] for each in dropped)
        for at in range(len(names))
    ]
    if not any(chosen):
        raise LumitreeError(f"{file}: --keep and --drop leave nothing; keep more or drop less")
    return chosen


def matching(
    pattern: str,
    option: str,
    names: Sequence[Sequence[str]],
    file: str,
    kind: str,
    listed: Sequence[str] | None = None,
    how: str = "",
) -> list[bool]:
    """Which of the things a pattern with * and ? matches, by one of their names.

    Args:
        option, file, kind: the pattern's option, the name of the file, and what the things are, for
            messages.
        listed: descriptions of the things, for messages. They may then be chosen by number, too, as
            "#3". None: by names alone.
        how: end of the message.

    Raises:
        LumitreeError: it matches nothing.
    """
    if listed is not None and _NUMBER.fullmatch(pattern):
        found = [at == int(pattern[1:]) for at in range(len(names))]
    else:
        found = [any(fnmatch.fnmatchcase(name, pattern) for name in each) for each in names]
    if not any(found):
        every = dict.fromkeys(name for each in names for name in each if name)
        raise LumitreeError(
            f"{file}: {option} {shown(pattern)!r} matches no {kind}; there are "
            f"{shown_names(every if listed is None else listed)}{how}"
        )
    return found
