"""An OBJ file with its MTL files as a model."""

import dataclasses
import os
import re
import warnings
from collections.abc import Collection, Iterable
from pathlib import Path

from lumitree.errors import LumitreeWarning, shown, shown_names
from lumitree.lamp.importers.mesh_faces import by_handedness
from lumitree.lamp.importers.obj.files import ObjFolder
from lumitree.lamp.importers.obj.materials import emits, material, without_mtl
from lumitree.lamp.importers.obj.mesh import build_meshes
from lumitree.lamp.importers.obj.mtl import MtlMaterial, parse_mtl
from lumitree.lamp.importers.obj.parse import ObjFile, parse_obj
from lumitree.lamp.importers.topology import count_solids
from lumitree.lamp.meshes import Mesh
from lumitree.lamp.names import Names
from lumitree.lamp.parts import RGB, Geometry, Material, Part, Texture

_UNNAMED = "default"
_MAX_NAME = 60


def read_obj(path: str | os.PathLike[str], emitting: Collection[str] = ()) -> Geometry:
    """Read a Wavefront OBJ model: one part for each material, in the file's frame and unit.

    Args:
        path: of the file.
        emitting: materials that will emit, besides those that do so in the file.

    Raises:
        LumitreeError: a file is missing, malformed or too large, or names what is outside the
            model's folder.
    """
    path = Path(path)
    file = parse_obj(path)
    folder = ObjFolder(path)
    library = _library(file, folder)
    lit = [name for name, source in library.items() if emits(source)]
    meshes = build_meshes(file, {*lit, *emitting})
    if not meshes:
        warnings.warn(f"{path}: no face has any area", LumitreeWarning, stacklevel=2)
    names = part_names(file.materials[number] for number in meshes)
    missing = [name for name in file.materials if name and name not in library]
    if missing:
        warnings.warn(
            f"{shown(path, 300)}: no MTL file describes {shown_names(missing)}; taken to be grey, "
            "or to have the colours of its vertices",
            LumitreeWarning,
            stacklevel=2,
        )
    materials: dict[str, Material] = {}
    parts, taken, titles = [], Names("-"), Names(" ")
    for name in names:
        taken.unique(name)
    for title in (*file.materials, _UNNAMED):
        titles.unique(title)
    for name, (number, mesh) in zip(names, meshes.items(), strict=True):
        title = file.materials[number] or _UNNAMED
        source = library.get(file.materials[number])
        made, factor = _material(title, source, mesh, folder)
        colours = None if mesh.colours is None or factor is None else mesh.colours * factor
        coloured = dataclasses.replace(mesh, colours=colours)
        pieces = by_handedness(coloured, made.normal_map is not None)
        for count, (piece, mirrored) in enumerate(pieces):
            used = made
            if mirrored:
                own = titles.unique(f"{title} mirrored")
                used = dataclasses.replace(made, name=own, normal_map=_turned(made.normal_map))
            materials[used.name] = used
            parts.append(Part(taken.unique(name) if count else name, piece, used.name))
    return Geometry(tuple(parts), tuple(materials.values()))


def _turned(normal_map: Texture | None) -> Texture | None:
    """A normal map with its second axis turned round."""
    if normal_map is None:
        return None
    pixels = normal_map.pixels.copy()
    pixels[..., 1] = 255 - pixels[..., 1]
    return dataclasses.replace(normal_map, pixels=pixels)


def _material(
    title: str, source: MtlMaterial | None, mesh: Mesh, folder: ObjFolder
) -> tuple[Material, RGB | None]:
    """A material, and the factor of its mesh's vertex colours; None where it ignores them."""
    coloured = mesh.colours is not None
    if source is None:
        return without_mtl(title, coloured)

    def closed_throughout() -> bool:
        closed, pieces = count_solids(mesh)
        if 0 < closed < pieces:
            warnings.warn(
                f"material {shown(title)!r}: {closed} of {pieces} pieces are closed, the others "
                "are not; all are taken to be thin sheets of glass",
                LumitreeWarning,
                stacklevel=2,
            )
        return closed == pieces

    return material(title, source, closed_throughout, coloured, folder)


def _library(file: ObjFile, folder: ObjFolder) -> dict[str, MtlMaterial]:
    """Materials of all `mtllib` lines; the first of a name counts."""
    paths: dict[Path, None] = {}
    for line in dict.fromkeys(file.libraries):
        # A line may hold several names, or one name with spaces in it.
        whole = line.lower().count(".mtl") <= 1
        for name in [line] if whole else line.split():
            path = folder.find(name.strip('"'), "mtllib")
            if path is not None:
                paths[path] = None
    found: dict[str, MtlMaterial] = {}
    for path in paths:
        for name, entry in parse_mtl(path).items():
            found.setdefault(name, _with_images_beside(entry, path, folder))
    return found


def _with_images_beside(material: MtlMaterial, library: Path, folder: ObjFolder) -> MtlMaterial:
    """A material whose maps are those beside its MTL file, where that is in a folder below."""
    maps = {
        key: dataclasses.replace(entry, file=folder.name_beside(library, entry.file))
        for key, entry in material.maps.items()
    }
    return dataclasses.replace(material, maps=maps)


def part_names(titles: Iterable[str]) -> list[str]:
    """Distinct names, fit for files, made from any text."""
    names = Names("-")
    bases = (re.sub(r"[^A-Za-z0-9_-]+", "_", title)[:_MAX_NAME].strip("_") for title in titles)
    return [names.unique(base or _UNNAMED) for base in bases]
