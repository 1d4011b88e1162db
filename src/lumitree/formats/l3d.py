"""L3D files: the parts of a luminaire, and its light emitting objects.

An L3D file is a zip archive of `structure.xml` and of OBJ models, each with its materials and
images in a folder with the id of its definition. The XML is a tree of parts and joints, each with a
position in metres and a rotation in degrees: about z, then about the new x, then about the new y.
z is up. A light emitting object lies in its own x-y plane; its photometry has γ = 0 along -z and
C = 0 along x.
"""

import dataclasses
from collections.abc import Iterator
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from lumitree.core.frames import rotation, similarity
from lumitree.errors import LumitreeError, shown
from lumitree.formats.archive import Archive
from lumitree.formats.opening import Opening
from lumitree.formats.xml_tree import number_of, parse_xml

KIND = "an L3D model"
_STRUCTURE = "structure.xml"
_METRES = {
    "m": 1.0,
    "dm": 0.1,
    "cm": 0.01,
    "mm": 0.001,
    "yard": 0.9144,
    "foot": 0.3048,
    "inch": 0.0254,
}
_MM_PER_M = 1000.0
_MAX_METRES, _MAX_PARTS = 1e4, 1000
Matrix = NDArray[np.float64]


@dataclasses.dataclass(frozen=True, eq=False)
class LightObject:
    """A light emitting object.

    Attributes:
        name: by which GLDF refers to it.
        place: [4, 4] from its frame to the luminaire's, m.
        opening: with y up, as photometric files have it, centred at the origin of its frame.
    """

    name: str
    place: Matrix
    opening: Opening


@dataclasses.dataclass(frozen=True)
class LightFaces:
    """Faces of an OBJ model that look luminous.

    Attributes:
        object_name: of the light emitting object whose light they show.
        weight: relative luminance, 0 to 1.
        ranges: group, first and last face of each range, counted from 0.
    """

    object_name: str
    weight: float
    ranges: tuple[tuple[int, int, int], ...]


@dataclasses.dataclass(frozen=True, eq=False)
class L3dPart:
    """An OBJ model in its place; `place` [4, 4] is from its coordinates to the luminaire's, m."""

    folder: str
    file: str
    place: Matrix
    lights: tuple[LightFaces, ...]


@dataclasses.dataclass(frozen=True, eq=False)
class L3d:
    """The model of an L3D file, with its joints as the file sets them."""

    parts: tuple[L3dPart, ...]
    objects: tuple[LightObject, ...]

    def object(self, name: str) -> LightObject:
        """The light emitting object of a name, which must exist."""
        for each in self.objects:
            if each.name == name:
                return each
        names = ", ".join(shown(each.name, 40) for each in self.objects[:12])
        raise LumitreeError(
            f"its 3D model has no light emitting object {shown(name)!r}; it has {names or 'none'}"
        )


def read_l3d(archive: Archive) -> L3d:
    """Read `structure.xml` of an L3D file."""
    content = archive.read(_STRUCTURE, "the structure of an L3D model")
    root = parse_xml(content, f"{_STRUCTURE} in {archive.name}", KIND)
    try:
        return _Reader(root).read()
    except LumitreeError as error:
        raise LumitreeError(f"{archive.name} is not a usable L3D model: {error}") from None


class _Reader:
    def __init__(self, root: Element) -> None:
        if root.tag != "Luminaire":
            raise LumitreeError(
                f"{_STRUCTURE} begins with <{shown(root.tag)}>; expected <Luminaire>"
            )
        self._root = root
        self._definitions = {
            each.get("id", ""): each
            for each in root.iterfind("GeometryDefinitions/GeometryFileDefinition")
        }
        self._parts: list[L3dPart] = []
        self._objects: list[LightObject] = []

    def read(self) -> L3d:
        for part in self._root.iterfind("Structure/Geometry"):
            self._add(part, np.eye(4))
        if not self._objects:
            raise LumitreeError("it has no light emitting object")
        return L3d(tuple(self._parts), tuple(self._objects))

    def _add(self, part: Element, parent: Matrix) -> None:
        """A part, and what is joined to it."""
        place = parent @ _place(part)
        reference = part.find("GeometryReference")
        definition = self._definitions.get(
            "" if reference is None else reference.get("geometryId", "")
        )
        if definition is None:
            raise LumitreeError(f"part {_name(part)} refers to no geometry definition")
        units = definition.get("units", "")
        if units not in _METRES:
            raise LumitreeError(f"a unit is {shown(units)!r}; expected {', '.join(_METRES)}")
        self._parts.append(
            L3dPart(
                definition.get("id", ""),
                definition.get("filename", ""),
                place @ similarity(np.eye(3), _METRES[units], np.zeros(3)),
                tuple(_light_faces(part)),
            )
        )
        for each in part.iterfind("LightEmittingObjects/LightEmittingObject"):
            self._objects.append(
                LightObject(each.get("partName", ""), place @ _place(each), _opening(each))
            )
        if len(self._parts) + len(self._objects) > _MAX_PARTS:
            raise LumitreeError(f"it has more than {_MAX_PARTS} parts and light emitting objects")
        for joint in part.iterfind("Joints/Joint"):
            turned = place @ _place(joint)
            default = joint.find("DefaultRotation")
            if default is not None:
                turned = turned @ similarity(_rotation(default), 1.0, np.zeros(3))
            for child in joint.iterfind("Geometries/Geometry"):
                self._add(child, turned)


def _name(element: Element) -> str:
    return repr(shown(element.get("partName", "")))


def _place(element: Element) -> Matrix:
    """[4, 4] of the position and rotation of a part."""
    position, turn = element.find("Position"), element.find("Rotation")
    at = np.zeros(3) if position is None else np.array(_vector(position))
    if not (np.abs(at) <= _MAX_METRES).all():
        raise LumitreeError(f"the position of {_name(element)} is {at.tolist()} m")
    return similarity(np.eye(3) if turn is None else _rotation(turn), 1.0, at)


def zxy(x: float, y: float, z: float) -> Matrix:
    """Rotation [3, 3] about z, then about the new x, then about the new y; degrees."""
    return rotation((0, 0, 1), z) @ rotation((1, 0, 0), x) @ rotation((0, 1, 0), y)


def _rotation(element: Element) -> Matrix:
    return zxy(*_vector(element))


def _vector(element: Element) -> tuple[float, float, float]:
    return number_of(element, "x"), number_of(element, "y"), number_of(element, "z")


def _opening(element: Element) -> Opening:
    heights, height = element.find("LuminousHeights"), 0.0
    if heights is not None:
        # Millimetres, where all other lengths are in metres.
        height = max(abs(number_of(heights, f"c{c}", 0.0)) for c in (0, 90, 180, 270)) / _MM_PER_M
    rectangle, circle = element.find("Rectangle"), element.find("Circle")
    if rectangle is not None:
        x, y = (abs(number_of(rectangle, key)) for key in ("sizeX", "sizeY"))
        return Opening((x, height, y))
    if circle is None:
        raise LumitreeError(f"{_name(element)} is neither a rectangle nor a circle")
    diameter = abs(number_of(circle, "diameter"))
    return Opening((diameter, height, diameter), "cylinder")


def _light_faces(part: Element) -> Iterator[LightFaces]:
    for surface in part.iterfind("LightEmittingSurfaces/LightEmittingSurface"):
        reference = surface.find("LightEmittingObjectReference")
        faces = surface.find("FaceAssignments")
        if reference is None or faces is None:
            continue
        weight = number_of(reference, "intensity", 1.0)
        yield LightFaces(
            reference.get("lightEmittingPartName", ""),
            float(np.clip(weight, 0, 1)),
            tuple(_range(each) for each in faces),
        )
    # Until version 0.9.
    for each in part.iterfind("LightEmittingFaceAssignments/*"):
        yield LightFaces(each.get("lightEmittingPartName", ""), 1.0, (_range(each),))


def _range(element: Element) -> tuple[int, int, int]:
    single = element.get("faceIndex") is not None
    first, last = ("faceIndex",) * 2 if single else ("faceIndexBegin", "faceIndexEnd")
    group = number_of(element, "groupIndex", 0.0)
    return int(group), int(number_of(element, first)), int(number_of(element, last))
