"""L3D files: the parts of a luminaire, and its light emitting objects.

An L3D file is a zip archive of `structure.xml` and of OBJ models, each with its materials and
images in a folder with the id of its definition. The XML is a tree of parts and joints, each with a
position in metres and a rotation in degrees: about z, then about the new x, then about the new y.
z is up. A light emitting object lies in its own x-y plane; its photometry has γ = 0 along -z and
C = 0 along x.

The OBJ models become the geometry of an asset. Faces that the file marks as luminous emit as
Lambertian surfaces do, with the luminous flux of their light emitting object; an object without
such faces emits from its own rectangle or disk. This light is for images of the luminaire alone.
Materials are from the MTL files; they emit nothing.
"""

import dataclasses
from collections import Counter
from collections.abc import Iterator, Mapping
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.materials import Diffuse
from lumitree.core.file_kinds import in_utf8
from lumitree.core.files import write_bytes
from lumitree.core.frames import rotation, similarity
from lumitree.core.photometry import radiance_from_flux
from lumitree.errors import LumitreeError, shown
from lumitree.formats.opening import Opening
from lumitree.formats.reading import Archive, number_of, parse_xml
from lumitree.lamp.importers.model_files import Images, num_pixels
from lumitree.lamp.importers.obj import part_names, read_obj
from lumitree.lamp.importers.overrides import emitting_area
from lumitree.lamp.materials import WHITE, Material
from lumitree.lamp.meshes import Mesh
from lumitree.lamp.parts import Geometry, Names, Part

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
# y up, from z up.
Y_UP: Matrix = np.array([[1.0, 0, 0, 0], [0, 0, 1, 0], [0, -1, 0, 0], [0, 0, 0, 1]])
_LIGHTS = "lumitree-lights.mtl"
_FILES = (".mtl", ".png", ".jpg", ".jpeg")
# Prefix of the names of luminous materials, before the index in a part's `lights`.
_LIGHT = "lumitree-light-"
_SEGMENTS = 64
# Limits of an OBJ model; triangles in all places and pixels of all images of all models.
_MAX_OBJ_BYTES, _MAX_LINES, _MAX_CORNERS = 32 * 2**20, 1 << 20, 1 << 21
_MAX_TRIANGLES, _MAX_PIXELS = 1 << 19, 1 << 24
# Distance of an object's own shape from its plane, in front of it, as a part of its longest side.
_BEFORE = 2e-3


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
        """Add a part, and the parts joined to it."""
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
                turned = turned @ similarity(zxy(*_vector(default)), 1.0, np.zeros(3))
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
    return similarity(np.eye(3) if turn is None else zxy(*_vector(turn)), 1.0, at)


def zxy(x: float, y: float, z: float) -> Matrix:
    """Rotation [3, 3] about z, then about the new x, then about the new y; degrees."""
    return rotation((0, 0, 1), z) @ rotation((1, 0, 0), x) @ rotation((0, 1, 0), y)


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


def l3d_geometry(
    archive: Archive, model: L3d, lumens: Mapping[str, float], folder: Path
) -> Geometry:
    """Parts and materials of a luminaire, in metres, y up.

    Only faces of the light emitting objects in `lumens` (lm) emit. The files of the models are
    written to `folder`, which is empty. A model has at most 32 MiB, 2²⁰ lines and 2²¹ corners of
    faces; a luminaire 2¹⁹ triangles and 2²⁴ pixels of images.
    """
    return _Builder(archive, lumens, folder).build(model)


class _Builder:
    """Geometry of a model; arguments as for `l3d_geometry`."""

    def __init__(self, archive: Archive, lumens: Mapping[str, float], folder: Path) -> None:
        self._archive, self._lumens, self._folder = archive, lumens, folder
        self._read: dict[tuple[object, ...], Geometry] = {}
        self._names, self._triangles, self._pixels = Names("-"), 0, 0
        self._images = Images()
        self._parts: list[Part] = []
        self._materials: dict[str, Material] = {}
        # For luminous materials: the light emitting object, and the weight of its area.
        self._lit: dict[str, tuple[str, float]] = {}

    def build(self, model: L3d) -> Geometry:
        for part in model.parts:
            self._add(part)
        emitting = {name for name, _ in self._lit.values()}
        for each in model.objects:
            if self._lumens.get(each.name, 0) > 0 and each.name not in emitting:
                self._add_shape(each)
        images = tuple(self._images.pixels)
        geometry = Geometry(tuple(self._parts), tuple(self._materials.values()), images)
        return dataclasses.replace(geometry, materials=self._emitting(geometry))

    def _add(self, part: L3dPart) -> None:
        """Add the meshes of a part."""
        read = self._obj(part)
        self._triangles += sum(len(each.mesh.faces) for each in read.parts)
        if self._triangles > _MAX_TRIANGLES:
            raise LumitreeError(f"it has more than {_MAX_TRIANGLES} triangles in all places")
        place = Y_UP @ part.place
        lights = {f"{_LIGHT}{index}": light for index, light in enumerate(part.lights)}
        names = {}
        for material in read.materials:
            light = lights.get(material.name)
            if light is not None and self._lumens.get(light.object_name, 0) > 0:
                made = self._luminous(light.object_name, light.weight)
            else:
                name = f"{part.folder}/{material.name}"
                made = dataclasses.replace(material, name=name, radiance=None)
            names[material.name] = made.name
            self._materials[made.name] = made
        for title, each in zip(part_names(names.values()), read.parts, strict=True):
            self._parts.append(
                Part(self._names.unique(title), each.mesh, names[each.material], (place,))
            )

    def _luminous(self, name: str, weight: float) -> Material:
        """A new luminous material, black and without its radiance."""
        material = Material(f"{_LIGHT}{len(self._lit)}", Diffuse(reflectance=(0.0, 0.0, 0.0)))
        self._lit[material.name] = (name, weight)
        return material

    def _add_shape(self, light: LightObject) -> None:
        """The rectangle or disk of an object, whose light goes along -z."""
        x, _, y = light.opening.sides
        if not min(x, y) > 0:
            return
        corners = np.array([[-1.0, -1], [-1, 1], [1, 1], [1, -1]])
        if light.opening.shape == "cylinder":
            angle = -2 * np.pi * np.arange(_SEGMENTS) / _SEGMENTS
            corners = np.stack([np.cos(angle), np.sin(angle)], axis=1)
        # In front of the surface of the model that it may lie on.
        vertices = np.insert(corners * [x / 2, y / 2], 2, -_BEFORE * max(x, y), axis=1)
        count = len(corners)
        faces = np.stack([np.zeros(count - 2), np.arange(1, count - 1), np.arange(2, count)], 1)
        normals = np.broadcast_to([0.0, 0.0, -1.0], vertices.shape)
        material = self._luminous(light.name, 1.0)
        self._materials[material.name] = material
        mesh = Mesh(vertices, normals, faces.astype(np.int64))
        name = self._names.unique(part_names([light.name])[0])
        self._parts.append(Part(name, mesh, material.name, (Y_UP @ light.place,)))

    def _emitting(self, geometry: Geometry) -> tuple[Material, ...]:
        """The materials, with the radiance that gives each object its luminous flux."""
        areas = {name: emitting_area(geometry, name) for name in self._lit}
        total = dict.fromkeys(self._lumens, 0.0)
        for name, (owner, weight) in self._lit.items():
            total[owner] += weight * areas[name]
        found = []
        for material in geometry.materials:
            if material.name in self._lit:
                owner, weight = self._lit[material.name]
                if total[owner] > 0 and weight > 0:
                    lumens = self._lumens[owner] * weight
                    radiance = radiance_from_flux(lumens, total[owner], WHITE)
                    material = dataclasses.replace(material, radiance=radiance)
            found.append(material)
        return tuple(found)

    def _obj(self, part: L3dPart) -> Geometry:
        """The OBJ model of a part, whose luminous faces have materials of their own."""
        lit = tuple(
            (index, light.ranges)
            for index, light in enumerate(part.lights)
            if self._lumens.get(light.object_name, 0) > 0
        )
        key = (part.folder, part.file, lit)
        if key not in self._read:
            folder = self._folder / f"{plain_name(part.folder)}-{len(self._read)}"
            path = folder / f"{plain_name(Path(part.file).stem)}.obj"
            content = self._archive.read(
                f"{part.folder}/{part.file}", "an OBJ model", _MAX_OBJ_BYTES
            )
            names = self._archive.names(part.folder)
            for name in names:
                if name.lower().endswith(_FILES) and Path(name).name == name and len(name) < 200:
                    data = self._archive.read(f"{part.folder}/{name}", "a file of an OBJ model")
                    self._pixels += num_pixels(data)
                    if self._pixels > _MAX_PIXELS:
                        raise LumitreeError(f"its images have more than {_MAX_PIXELS} pixels")
                    write_bytes(folder / name, data)
            mtl = "".join(f"newmtl {_LIGHT}{index}\nKd 0 0 0\nKe 1 1 1\n" for index, _ in lit)
            write_bytes(folder / _LIGHTS, mtl.encode())
            libraries = any(name.lower().endswith(".mtl") for name in names)
            write_bytes(path, _marked(content, dict(lit), libraries))
            self._read[key] = read_obj(path, images=self._images)
        return self._read[key]


def plain_name(name: str) -> str:
    """A name of a member of an archive, made fit for a file."""
    kept = "".join(char if char.isalnum() or char in " -_." else "_" for char in name[:80])
    return kept.strip(" .") or "file"


def _marked(
    content: bytes, lights: Mapping[int, tuple[tuple[int, int, int], ...]], libraries: bool
) -> bytes:
    """The text of an OBJ model in which faces of each light use a material of their own.

    Faces are counted from 0 within their group; a model without groups is one. `lights` has group,
    first and last face of each range. Without `libraries` the text names no MTL file.
    """
    lines = in_utf8(content).replace(b"\\\n", b" ").split(b"\n", _MAX_LINES)
    places = _face_places(lines) if len(lines) <= _MAX_LINES else []
    faces = (line for line, place in zip(lines, places, strict=False) if place is not None)
    if not places or sum(len(line.split()) - 1 for line in faces) > _MAX_CORNERS:
        raise LumitreeError(
            f"an OBJ model has more than {_MAX_LINES} lines or {_MAX_CORNERS} corners of faces"
        )
    counts = Counter(place[0] for place in places if place is not None)
    lit = {group: np.full(count, -1) for group, count in counts.items()}
    for index, ranges in lights.items():
        for group, first, last in ranges:
            if group in lit:
                lit[group][max(first, 0) : max(last + 1, 0)] = index
    result = [f"mtllib {_LIGHTS}".encode()] if lights else []
    material, marked = b"usemtl", False
    for line, place in zip(lines, places, strict=True):
        key = line.split(None, 1)[:1]
        if place is not None:
            index = int(lit[place[0]][place[1]])
            if index >= 0:
                result.append(f"usemtl {_LIGHT}{index}".encode())
            elif marked:
                result.append(material)
            marked = index >= 0
        elif key == [b"usemtl"]:
            material, marked = line, False
        if key != [b"mtllib"] or libraries:
            result.append(line)
    return b"\n".join(result)


def _face_places(lines: list[bytes]) -> list[tuple[int, int] | None]:
    """Group of each line that is a face, and its number there; None for other lines.

    Groups without faces do not count. If there are others, faces before the first group are in -1.
    """
    current: bytes | None = None
    owners: list[bytes | None] = []
    faces: list[bool] = []
    for line in lines:
        words = line.split(None, 1) or [b""]
        if words[0] in (b"g", b"o"):
            current = words[-1].strip()
        owners.append(current)
        faces.append(words[0] == b"f")
    used = dict.fromkeys(owner for owner, face in zip(owners, faces, strict=True) if face)
    named = [owner for owner in used if owner is not None]
    order: dict[bytes | None, int] = {None: -1 if named else 0}
    order |= {owner: index for index, owner in enumerate(named)}
    counts: Counter[int] = Counter()
    places: list[tuple[int, int] | None] = []
    for owner, face in zip(owners, faces, strict=True):
        group = order.get(owner, -1)
        places.append((group, counts[group]) if face else None)
        counts[group] += face
    return places
