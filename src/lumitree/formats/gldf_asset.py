"""Assets of GLDF files: the light of their photometries, from the openings of their 3D models.

The light of an emitter starts on its light emitting object, with the intensities of its
photometry. The 3D model is the geometry of the asset, which images show.
"""

import dataclasses
import os
import warnings
from collections.abc import Sequence
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.geometry import AssetGeometry
from lumitree.core.files import scratch_folder, write_bytes
from lumitree.core.frames import LocalFrame
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.formats.archive import Archive
from lumitree.formats.gldf import KIND, GldfEmitter, GldfFile, GldfVariant, read_variant
from lumitree.formats.l3d import KIND as L3D_KIND
from lumitree.formats.l3d import L3d, read_l3d
from lumitree.formats.l3d_geometry import Y_UP, l3d_geometry, plain_name
from lumitree.formats.light_field import bake_distribution
from lumitree.formats.light_sources import LightSource, bake_sources
from lumitree.formats.photometric_file import read_photometry
from lumitree.formats.photometric_text import warn_of_file
from lumitree.formats.tm33 import read_tm33
from lumitree.formats.type_c import IntensityDistribution
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.scene_writer import write_scene
from lumitree.lamp.stored_geometry import stored_geometry

_SUFFIX_OF = {"ldc/eulumdat": ".ldt", "ldc/ies": ".ies", "ldc/iesxml": ".xml"}
# Relative change of a luminous flux that is warned of.
_CHANGED = 0.01


def bake_gldf(path: str | os.PathLike[str], chosen: str | None = None) -> Asset:
    """Asset of a variant of a GLDF file, by its id or name, or of the first; warns of omissions."""
    archive = Archive.open(path, KIND)
    variant = read_variant(archive, path, chosen)
    with scratch_folder() as folder:
        return _Bake(archive, path, variant, folder).asset()


class _Bake:
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
        if model is None and len(sources) == 1 and (sources[0].place == np.eye(4)).all():
            return self._single(sources[0])
        frame = LocalFrame.of_box(corners.min(axis=0), corners.max(axis=0))
        asset = bake_sources(sources, frame, self._variant.name)
        return dataclasses.replace(asset, geometry=geometry)

    def _single(self, source: LightSource) -> Asset:
        """The asset of a photometry as its file has it."""
        asset = bake_distribution(
            dataclasses.replace(
                source.distribution, name=self._variant.name, opening=source.opening
            )
        )
        field, factor = asset.light_field, source.lumens / source.distribution.lumens
        assert field is not None
        return dataclasses.replace(
            asset, light_field=dataclasses.replace(field, scale=field.scale * factor)
        )

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
                self._photometries[file] = _read(copy)
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


def _read(path: Path) -> IntensityDistribution:
    # Other files are refused as TM-33.
    return (read_photometry(path) or read_tm33(path))[0]
