"""GLDF files (`.gldf`, Global Lighting Data Format 1.0): the product that `product.xml` describes.

A GLDF file is a zip archive of `product.xml` and of the files that it names, each in a folder that
is the first part of its content type:

    product.xml
    ldc/x.ldt           photometric files: ldc/eulumdat, ldc/ies, ldc/iesxml
    geo/y.l3d           geometry: geo/l3d, see `l3d`; geo/r3d and geo/m3d are not read
    image/, document/, ...

The XML has variants of the product. A variant joins a geometry and emitters; an emitter has a
photometry, a rotation and a luminous flux. In a variant x, y and z are GLDF's: z is up.

The asset of a variant has the light of the photometries, each on its light emitting object with the
intensities of the photometry. The 3D model is its geometry, which images show.
"""

import dataclasses
import os
import warnings
from collections.abc import Callable, Sequence
from pathlib import Path
from xml.etree.ElementTree import Element

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.geometry import AssetGeometry
from lumitree.core.files import scratch_folder, write_bytes
from lumitree.core.frames import LocalFrame, rotation
from lumitree.errors import LumitreeError, LumitreeWarning, shown, shown_names
from lumitree.formats.ies import read_ies
from lumitree.formats.l3d import KIND as L3D_KIND
from lumitree.formats.l3d import Y_UP, L3d, l3d_geometry, plain_name, read_l3d, zxy
from lumitree.formats.ldt import read_ldt
from lumitree.formats.light_field import bake_distribution
from lumitree.formats.light_sources import LightSource, bake_sources
from lumitree.formats.opening import Opening
from lumitree.formats.reading import Archive, number_of, parse_xml, text_of, warn_of_file
from lumitree.formats.tm33 import read_tm33
from lumitree.formats.type_c import IntensityDistribution
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.scene_writer import write_scene
from lumitree.lamp.stored_geometry import stored_geometry

KIND = "a GLDF file (.gldf)"
_PRODUCT = "product.xml"
_MM_PER_M = 1000.0
_EMITTERS = ("ChangeableLightEmitter", "FixedLightEmitter", "MultiChannelLightEmitter")
_DETAIL = {"Low": 0, "": 1, "Medium": 2, "High": 3}
_MAX_SOURCES = 200
_SUFFIX_OF = {"ldc/eulumdat": ".ldt", "ldc/ies": ".ies", "ldc/iesxml": ".xml"}
_READERS: dict[str, Callable[[Path], IntensityDistribution]] = {
    ".ldt": read_ldt,
    ".ies": read_ies,
    ".xml": lambda path: read_tm33(path)[0],
}
# Relative change of a luminous flux that is warned of.
_CHANGED = 0.01


@dataclasses.dataclass(frozen=True)
class GldfFile:
    """A file that a product names, or its address; `content_type` is such as "ldc/ies"."""

    name: str
    content_type: str
    is_local: bool

    def member(self, archive: Archive) -> str:
        """Its name in the archive, where it must be."""
        where = f"{self.content_type.partition('/')[0]}/{self.name}"
        if not self.is_local:
            raise LumitreeError(
                f"{archive.name} names {shown(self.name, 200)}, which is not in the file; nothing "
                "is downloaded: ask for a file that contains its photometries"
            )
        found = archive.find(where, self.name)
        if found is None:
            raise LumitreeError(
                f"{archive.name} names {shown(where, 200)}, which is not in the archive; the file "
                "is incomplete"
            )
        return found


@dataclasses.dataclass(frozen=True, eq=False)
class GldfEmitter:
    """A photometry in a variant.

    Attributes:
        object_name: of the light emitting object of the 3D model; empty if there is no model.
        photometry: file of its intensities.
        turn: [3, 3] rotation of the photometry before it is placed.
        lumens: luminous flux of its light sources, lm, which replaces the flux in the file; None
            to keep this.
    """

    object_name: str
    photometry: GldfFile
    turn: NDArray[np.float64]
    lumens: float | None


@dataclasses.dataclass(frozen=True, eq=False)
class GldfVariant:
    """A variant of a product, with the emitters that are on in normal operation.

    `opening` is the luminous opening of a simple geometry, centred at the origin; None for the
    opening of the photometry. Each of `notes` is a warning.
    """

    name: str
    emitters: tuple[GldfEmitter, ...]
    model: GldfFile | None
    opening: Opening | None
    notes: tuple[str, ...]


def read_variant(archive: Archive, path: str | os.PathLike[str], chosen: str | None) -> GldfVariant:
    """The variant of an id or a name, or the first, of the product that a GLDF file describes."""
    content = archive.read(_PRODUCT, "the description of a product")
    root = parse_xml(content, f"{_PRODUCT} in {archive.name}", "a product of GLDF")
    try:
        return _Reader(root, shown(path, 200)).variant(chosen)
    except LumitreeError as error:
        raise LumitreeError(f"{archive.name} is not a usable GLDF file: {error}") from None


class _Reader:
    def __init__(self, root: Element, path: str) -> None:
        if root.tag != "Root":
            raise LumitreeError(f"{_PRODUCT} begins with <{shown(root.tag)}>; expected <Root>")
        self._root, self._path = root, path
        self._notes: list[str] = []
        self._by_id: dict[tuple[str, str], Element] = {}
        for element in root.iter():
            if (name := element.get("id")) is not None:
                self._by_id.setdefault((element.tag, name), element)

    def variant(self, chosen: str | None) -> GldfVariant:
        found = self._chosen(chosen)
        product = self._name(self._root.find("ProductDefinitions/ProductMetaData"))
        name = " ".join(dict.fromkeys(each for each in (product, self._name(found)) if each))
        emitters, model, opening = self._geometry(found)
        if not emitters:
            version = text_of(self._root, "Header/FormatVersion")
            old = f"; it is of version {shown(version)}, where 1.0 is read" if version else ""
            raise LumitreeError(
                f"its variant {shown(found.get('id', ''))!r} has no emitter that lights in normal "
                f"operation{old if version.startswith('0') else ''}"
            )
        return GldfVariant(
            shown(name) or "GLDF", tuple(emitters), model, opening, tuple(self._notes)
        )

    def _chosen(self, chosen: str | None) -> Element:
        variants = self._root.findall("ProductDefinitions/Variants/Variant")
        if not variants:
            raise LumitreeError("it has no variants")
        variants.sort(key=lambda each: number_of(each, "sortOrder", np.inf))
        ids = [each.get("id", "") for each in variants]
        if chosen is None:
            if len(variants) > 1:
                self._notes.append(
                    f"the first of its {len(variants)} variants is read, {shown(ids[0])!r}; "
                    f"{self._path}#ID chooses another one: {shown_names(ids[1:])}"
                )
            return variants[0]
        for key in (lambda each: each.get("id", ""), self._name):
            for each in variants:
                if key(each) == chosen:
                    return each
        raise LumitreeError(f"it has no variant {shown(chosen)!r}; it has {shown_names(ids)}")

    @staticmethod
    def _name(element: Element | None) -> str:
        """Name in English, or in the first language."""
        if element is None:
            return ""
        english = text_of(element, "Name/Locale[@language='en']")
        return english or text_of(element, "Name/Locale")

    def _geometry(
        self, variant: Element
    ) -> tuple[list[GldfEmitter], GldfFile | None, Opening | None]:
        """Emitters, file of the model and simple opening of a variant."""
        geometry = variant.find("Geometry")
        top = Element("Geometry") if geometry is None else geometry
        both = top.find("GeometryReferences")
        top = top if both is None else both
        modelled, simple = top.find("ModelGeometryReference"), top.find("SimpleGeometryReference")
        if modelled is not None and (file := self._model(modelled)) is not None:
            references = [
                each
                for each in modelled.findall("EmitterReference")
                if each.get("targetModelType", "l3d") == "l3d"
            ]
            return self._emitters(references), file, None
        if simple is not None:
            return self._emitters([simple]), None, self._simple(simple)
        references = (top if modelled is None else modelled).findall("EmitterReference")
        # Models of several kinds may name the objects differently.
        references = [
            each
            for each in references
            if each.get("targetModelType") == references[0].get("targetModelType")
        ]
        if not references:
            emitters = self._root.findall("GeneralDefinitions/Emitters/Emitter")
            references = [Element("", emitterId=each.get("id", "")) for each in emitters]
            references = references if len(emitters) == 1 else []
        return self._emitters(references), None, None

    def _model(self, reference: Element) -> GldfFile | None:
        """The L3D file of most detail."""
        geometry = self._found("ModelGeometry", reference, "geometryId")
        files = [
            (self._file(each), _DETAIL.get(each.get("levelOfDetail", ""), 1))
            for each in geometry.findall("GeometryFileReference")
        ]
        usable = [each for each in files if each[0].content_type == "geo/l3d" and each[0].is_local]
        if usable:
            return max(usable, key=lambda each: each[1])[0]
        kinds = {each.content_type if each.is_local else "on the internet" for each, _ in files}
        self._notes.append(
            f"its 3D model ({shown_names(sorted(kinds))}) is not read, only L3D in the file; the "
            "light comes from the openings that the photometries state"
        )
        return None

    def _simple(self, reference: Element) -> Opening:
        geometry = self._found("SimpleGeometry", reference, "geometryId")
        heights = geometry.find("C-Heights")
        height = 0.0
        if heights is not None:
            height = max(abs(number_of(heights, f"C{c}", 0.0)) for c in (0, 90, 180, 270))
        height /= _MM_PER_M
        rectangle, circle = geometry.find("RectangularEmitter"), geometry.find("CircularEmitter")
        if rectangle is not None:
            # As in EULUMDAT, the width is along C = 0.
            width, length = (abs(number_of(rectangle, key)) for key in ("Width", "Length"))
            return Opening((width / _MM_PER_M, height, length / _MM_PER_M))
        if circle is None:
            raise LumitreeError(
                "a simple geometry has neither a rectangular nor a circular emitter"
            )
        diameter = abs(number_of(circle, "Diameter")) / _MM_PER_M
        return Opening((diameter, height, diameter), "cylinder")

    def _emitters(self, references: list[Element]) -> list[GldfEmitter]:
        """Emitters that light in normal operation; one for each channel."""
        found: list[GldfEmitter] = []
        for reference in references:
            emitter = self._found("Emitter", reference, "emitterId")
            name = text_of(reference, "EmitterObjectExternalName")
            lights = [each for each in emitter if each.tag in _EMITTERS]
            normal = [each for each in lights if each.get("emergencyBehaviour") != "EmergencyOnly"]
            if len(normal) < len(lights):
                self._notes.append("its emitters for emergency operation are not read")
            if len(normal) > 1:
                self._notes.append(
                    f"emitter {shown(emitter.get('id', ''))!r} has {len(normal)} interchangeable "
                    "light emitters; the first is read"
                )
            for light in normal[:1]:
                turn = _turn(light.find("Rotation"))
                found += [
                    GldfEmitter(name, self._photometry(photometry), turn, lumens)
                    for photometry, lumens in self._photometries(light)
                ]
            if len(found) > _MAX_SOURCES:
                raise LumitreeError(f"a variant has more than {_MAX_SOURCES} sources of light")
        self._notes = list(dict.fromkeys(self._notes))
        return found

    def _photometries(self, light: Element) -> list[tuple[Element, float | None]]:
        """Elements that refer to a photometry, and the luminous flux of the light sources."""
        if light.tag == "FixedLightEmitter":
            return [(light, _lumens(light))]
        if light.tag == "ChangeableLightEmitter":
            return [(light, self._equipped(light.find("EquipmentReference")))]
        reference = light.find("LightSourceReference")
        if reference is None:
            raise LumitreeError("a multi-channel emitter has no light source")
        source = self._found("MultiChannelLightSource", reference, "multiChannelLightSourceId")
        self._notes.append("all channels of its light source are on, without their colours")
        return [(each, _lumens(each)) for each in source.iter("Channel")]

    def _equipped(self, reference: Element | None) -> float | None:
        """Luminous flux of the lamps of an equipment."""
        if reference is None:
            return None
        equipment = self._found("Equipment", reference, "equipmentId")
        lamp = equipment.find("LightSourceReference")
        if lamp is None:
            return None
        source = self._found("ChangeableLightSource", lamp, "changeableLightSourceId")
        lumens = _lumens(source)
        return None if lumens is None else lumens * number_of(lamp, "lightSourceCount", 1.0)

    def _photometry(self, element: Element) -> GldfFile:
        reference = element.find("PhotometryReference")
        if reference is None:
            raise LumitreeError(f"a {element.tag} has no photometry")
        photometry = self._found("Photometry", reference, "photometryId")
        file = photometry.find("PhotometryFileReference")
        if file is None:
            raise LumitreeError("a photometry names no file")
        return self._file(file)

    def _file(self, reference: Element) -> GldfFile:
        file = self._found("File", reference, "fileId")
        return GldfFile(
            "".join(file.itertext()).strip(),
            file.get("contentType", ""),
            file.get("type", "localFileName") == "localFileName",
        )

    def _found(self, tag: str, reference: Element, key: str) -> Element:
        name = reference.get(key, "")
        found = self._by_id.get((tag, name))
        if found is None:
            raise LumitreeError(f"it has no {tag} {shown(name)!r}, which {key} names")
        return found


def _lumens(element: Element) -> float | None:
    lumens = number_of(element, "RatedLuminousFlux", 0.0)
    return lumens if lumens > 0 else None


def _turn(element: Element | None) -> NDArray[np.float64]:
    """Rotation of a photometry; G0 is about its own axis, towards increasing C."""
    if element is None:
        return np.eye(3)
    x, y, z, g0 = (number_of(element, key, 0.0) for key in ("X", "Y", "Z", "G0"))
    return zxy(x, y, z) @ rotation((0, 0, 1), g0)


def bake_gldf(path: str | os.PathLike[str], chosen: str | None = None) -> Asset:
    """Asset of a variant of a GLDF file, by its id or name, or of the first; warns of omissions."""
    archive = Archive.open(path, KIND)
    variant = read_variant(archive, path, chosen)
    with scratch_folder() as folder:
        return _Bake(archive, path, variant, folder).asset()


class _Bake:
    """The asset of a variant, whose files are written to an empty folder."""

    def __init__(
        self, archive: Archive, path: str | os.PathLike[str], variant: GldfVariant, folder: Path
    ) -> None:
        self._archive, self._path, self._variant = archive, path, variant
        self._folder = folder
        self._photometries: dict[GldfFile, IntensityDistribution] = {}
        for note in variant.notes:
            warn_of_file(path, note)

    def asset(self) -> Asset:
        model, inner = None, None
        if self._variant.model is not None:
            member = self._variant.model.member(self._archive)
            content = self._archive.read(member, L3D_KIND)
            name = f"{shown(member, 200)} in {self._archive.name}"
            inner = Archive(content, name, L3D_KIND, self._archive)
            model = read_l3d(inner)
        sources = [self._source(each, model) for each in self._variant.emitters]
        corners = np.concatenate([each.corners() for each in sources])
        geometry = None
        if model is not None and inner is not None:
            geometry, box = self._geometry(inner, model, sources)
            corners = np.concatenate([corners, box])
        if model is None and len(sources) == 1 and (sources[0].pose == np.eye(4)).all():
            (source,) = sources
            distribution = source.distribution
            asset = bake_distribution(
                dataclasses.replace(distribution, name=self._variant.name, opening=source.opening)
            )
            field, factor = asset.light_field, source.lumens / distribution.lumens
            assert field is not None
            scaled = dataclasses.replace(field, scale=field.scale * factor)
            return dataclasses.replace(asset, light_field=scaled)
        frame = LocalFrame.of_box(corners.min(axis=0), corners.max(axis=0))
        asset = bake_sources(sources, frame, self._variant.name)
        return dataclasses.replace(asset, geometry=geometry)

    def _source(self, emitter: GldfEmitter, model: L3d | None) -> LightSource:
        distribution = self._photometry(emitter.photometry)
        turn = np.eye(4)
        turn[:3, :3] = emitter.turn
        place, opening = np.eye(4), self._variant.opening or distribution.opening
        if model is not None:
            light = model.object(emitter.object_name)
            place, opening = light.place, light.opening
        return LightSource(
            distribution,
            opening,
            Y_UP @ place @ turn @ Y_UP.T,
            distribution.lumens * self._factor(emitter, distribution),
        )

    def _factor(self, emitter: GldfEmitter, distribution: IntensityDistribution) -> float:
        """Luminous flux of the light sources over the flux that the photometry was made with."""
        reference = distribution.emitted_lumens or distribution.lumens
        if emitter.lumens is None or not reference > 0:
            return 1.0
        factor = emitter.lumens / reference
        if abs(factor - 1) > _CHANGED:
            warn_of_file(
                self._path,
                f"it states {emitter.lumens:g} lm where {shown(emitter.photometry.name, 100)} is "
                f"for {reference:g} lm; its own number counts",
            )
        return factor

    def _photometry(self, file: GldfFile) -> IntensityDistribution:
        if file not in self._photometries:
            member = file.member(self._archive)
            suffix = Path(file.name).suffix.lower()
            suffix = suffix if suffix in _SUFFIX_OF.values() else _SUFFIX_OF.get(file.content_type)
            if suffix is None:
                raise LumitreeError(
                    f"{self._archive.name}: {shown(member, 200)} has the content type "
                    f"{shown(file.content_type)!r}; expected {', '.join(_SUFFIX_OF)}"
                )
            content = self._archive.read(member, "a photometric file")
            copy = self._folder / f"{plain_name(Path(file.name).stem)}{suffix}"
            write_bytes(copy, content)
            try:
                self._photometries[file] = _READERS[suffix](copy)
            except LumitreeError as error:
                where = f"{shown(member, 200)} in {self._archive.name}"
                raise LumitreeError(str(error).replace(shown(copy, 300), where)) from None
        return self._photometries[file]

    def _geometry(
        self, archive: Archive, model: L3d, sources: Sequence[LightSource]
    ) -> tuple[AssetGeometry | None, NDArray[np.float64]]:
        """Geometry of the model, and corners [N, 3] of its box; None if it cannot be used."""
        lumens: dict[str, float] = {}
        for emitter, source in zip(self._variant.emitters, sources, strict=True):
            lumens[emitter.object_name] = lumens.get(emitter.object_name, 0.0) + source.lumens
        try:
            geometry = l3d_geometry(
                archive, model, lumens, self._folder / plain_name(Path(self._path).name)
            )
            scene = write_scene(geometry, self._folder / "scene.l3d")
            luminaire = load_luminaire(scene)
            half, centre = luminaire.size / 2, luminaire.frame.centre
            return stored_geometry(luminaire), np.stack([centre - half, centre + half])
        except LumitreeError as error:
            warnings.warn(
                f"{shown(Path(self._path).name, 200)}: images show its light without its 3D model: "
                f"{error}",
                LumitreeWarning,
                stacklevel=3,
            )
            return None, np.zeros((0, 3))
