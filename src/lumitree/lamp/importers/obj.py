"""Wavefront OBJ models with MTL materials: one part for each material.

The formats are described in "Object Files (.obj)" and "Material Library File (.mtl)", Wavefront
Technologies, 1995.
"""

import dataclasses
import os
import re
import warnings
from collections.abc import Collection, Iterable
from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.materials import Texture
from lumitree.errors import LumitreeWarning, shown, shown_names
from lumitree.lamp.importers.faults import kept_faces, warn_of_repeated, with_reversed
from lumitree.lamp.importers.model_files import Images
from lumitree.lamp.importers.mtl import MtlMaterial, ObjFolder, material, parse_mtl
from lumitree.lamp.importers.obj_text import ObjFile, parse_obj
from lumitree.lamp.importers.polygons import triangulate
from lumitree.lamp.importers.topology import (
    CREASE,
    Indices,
    Pieces,
    crease_normals,
    face_normals,
    faces_to_turn,
    reach,
    unit,
    weld,
)
from lumitree.lamp.materials import Material
from lumitree.lamp.meshes import Floats, Mesh, by_handedness
from lumitree.lamp.parts import Geometry, Names, Part, check_shapes

# Sharpest angle, degrees, across which shading is smooth in a file that does not ask for it: faces
# of one plane share their vertices.
_FLAT = 0.1
_UNNAMED = "default"
_MAX_NAME = 60


@dataclasses.dataclass(frozen=True)
class _Triangles:
    """Some of the file's triangles.

    Attributes:
        corners: [F, 3, 3] position, texture coordinate and normal.
        groups: [F] smoothing groups.
        doubled: [F] whether they emit, and the file has them in both windings.
        within: `reach` of their material.
        repeated: number of polygons that are left out, since they repeat others.
    """

    corners: Indices
    groups: Indices
    doubled: NDArray[np.bool_]
    within: float
    repeated: int


def build_meshes(file: ObjFile, emitting: Collection[str]) -> dict[int, Mesh]:
    """Mesh of every material, by its number; materials whose faces have no area are left out.

    Faces that are repeated are kept once, whichever way the copies are wound; but of an emitting
    material once in each winding, so that both sides emit. Closed pieces face outwards. Missing
    normals are computed, smooth only where the file names smoothing groups, as the format says. v
    is 0 at an image's first row.
    """
    places = weld(file.positions)
    # One vertex stands for all those in its place.
    _, representative = np.unique(places, return_index=True)
    positions = file.positions[representative]
    starts = np.cumsum(file.sizes) - file.sizes
    order = np.argsort(file.material, kind="stable")
    used, begins = np.unique(file.material[order], return_index=True)
    check_shapes(len(used), shown(file.path, 300))
    meshes, repeated = {}, 0
    for number, chosen in zip(used.tolist(), np.split(order, begins[1:]), strict=True):
        name = file.materials[number]
        triangles = _cut(file, places, chosen, starts, name in emitting)
        repeated += triangles.repeated
        if len(triangles.corners):
            mesh = _mesh(file, places, positions, triangles, name)
            meshes[number] = with_reversed(mesh, triangles.doubled, triangles.within)
    warn_of_repeated(str(file.path), repeated)
    return meshes


def _cut(
    file: ObjFile, places: Indices, chosen: Indices, starts: Indices, emits: bool
) -> _Triangles:
    """The chosen polygons as triangles, in the file's order of sizes; repeated ones once."""
    corners: list[Indices] = [np.zeros((0, 3, 3), np.int64)]
    groups: list[Indices] = [np.zeros(0, np.int64)]
    doubled: list[NDArray[np.bool_]] = [np.zeros(0, np.bool_)]
    by_size, repeated = [], 0
    for size in np.unique(file.sizes[chosen]):
        polygons = chosen[file.sizes[chosen] == size]
        by_size.append((polygons, file.corners[starts[polygons][:, None] + np.arange(size)]))
    used = np.unique(np.concatenate([corners_of[..., 0].ravel() for _, corners_of in by_size]))
    within = reach(file.positions[used])
    for polygons, corners_of in by_size:
        keep, both = kept_faces(file.positions[corners_of[..., 0]], within, emits)
        repeated += int((~keep).sum() - both.sum())
        corners_of, polygons, both = corners_of[keep], polygons[keep], both[keep]
        pick, polygon = triangulate(file.positions[corners_of[..., 0]])
        corners.append(corners_of[polygon[:, None], pick])
        groups.append(file.smoothing[polygons[polygon]])
        doubled.append(both[polygon])
    every = np.concatenate(corners)
    at = places[every[..., 0]]
    proper = (at != np.roll(at, 1, axis=1)).all(axis=1)
    return _Triangles(
        every[proper],
        np.concatenate(groups)[proper],
        np.concatenate(doubled)[proper],
        within,
        repeated,
    )


def _mesh(
    file: ObjFile, places: Indices, positions: Floats, triangles: _Triangles, name: str
) -> Mesh:
    """Mesh of one material; `positions` are of the places.

    Everything is numbered anew first: work on what other materials use would be quadratic.
    """
    corners = triangles.corners.copy()
    used, faces = np.unique(places[corners[..., 0]], return_inverse=True)
    positions, faces = positions[used], faces.reshape(-1, 3)
    has_normal = corners[..., 2] >= 0
    used, index = np.unique(corners[..., 2][has_normal], return_inverse=True)
    given = file.normals[used]
    corners[..., 2][has_normal] = index
    flip = _turned(positions, faces, corners, given, name)
    faces[flip], corners[flip] = faces[flip][:, ::-1], corners[flip][:, ::-1]
    crease = CREASE if file.smooths else _FLAT
    index, normals = _normals(positions, faces, corners, given, triangles.groups, crease)
    used, vertex = _distinct([corners[..., 0].ravel(), corners[..., 1].ravel(), index.ravel()])
    given = used[:, 1] >= 0
    uv = np.zeros((len(used), 2))
    # v is counted from the first row; it is 0 where there are no texture coordinates.
    uv[given] = file.uv[used[given, 1]] * [1, -1] + [0, 1]
    # White changes nothing.
    colours = None if file.colours is None else file.colours[used[:, 0]]
    return Mesh(
        vertices=file.positions[used[:, 0]],
        normals=normals[used[:, 2]],
        faces=vertex.reshape(-1, 3),
        uv=uv if given.any() else None,
        colours=None if colours is None or (colours == 1).all() else colours,
    )


def _turned(
    positions: Floats, faces: Indices, corners: Indices, given: Floats, name: str
) -> NDArray[np.bool_]:
    """Faces [F] to turn: closed pieces are oriented outwards, open ones as their normals point."""
    pieces = Pieces(faces)
    flip = faces_to_turn(positions, faces, pieces, f"material {shown(name)!r}")
    if len(given):
        towards = (face_normals(positions, faces)[:, None] * _looked_up(given, corners)).sum((1, 2))
        against = np.bincount(pieces.label, towards, minlength=len(pieces.closed)) < 0
        flip |= (against & ~pieces.closed)[pieces.label]
    return flip


def _normals(
    positions: Floats,
    faces: Indices,
    corners: Indices,
    given: Floats,
    groups: Indices,
    crease: float,
) -> tuple[Indices, Floats]:
    """Number [F, 3] of every corner's normal, and unit normals: given, computed, or the face's.

    A normal that points to the back of its face would turn its glass inside out: if the normals
    of a whole closed piece do, they are turned with it, and single ones give way.
    """
    flat = face_normals(positions, faces)
    pieces = Pieces(faces)
    towards = (_looked_up(given, corners) * flat[:, None]).sum(axis=-1)
    total = np.bincount(pieces.label, towards.sum(axis=1), minlength=len(pieces.closed))
    turned = (total < 0)[pieces.label][:, None]
    usable = np.where(turned, -towards, towards) > 0
    index = corners[..., 2] + turned * len(given)
    normals = [unit(given), -unit(given)]
    if not usable.all():
        smooth_index, smooth = crease_normals(positions, faces, pieces, groups, crease)
        agrees = (smooth[smooth_index] * flat[:, None]).sum(axis=-1) > 0
        own_face = len(smooth) + np.arange(len(faces))[:, None]
        computed = 2 * len(given) + np.where(agrees, smooth_index, own_face)
        index = np.where(usable, index, computed)
        normals += [smooth, unit(flat)]
    return index, np.concatenate(normals)


def _looked_up(given: Floats, corners: Indices) -> Floats:
    """The file's unit normals at the corners [F, 3, 3]; zero where there is none."""
    index = corners[..., 2]
    if not len(given):
        return np.zeros((*index.shape, 3))
    length = np.linalg.norm(given, axis=1, keepdims=True)
    normals = np.divide(given, length, out=np.zeros_like(given), where=length > 0)
    return np.where(index[..., None] >= 0, normals[index], 0.0)


def _distinct(keys: list[Indices]) -> tuple[Indices, Indices]:
    """Distinct rows [U, K] of the columns, and the row [N] of each entry."""
    first, index = np.arange(len(keys[0])), np.zeros(len(keys[0]), np.int64)
    for key in keys:
        # Numbered anew after each column, so that the products stay small.
        combined = index * (int(key.max()) + 2) + key + 1
        _, first, index = np.unique(combined, return_index=True, return_inverse=True)
    return np.stack([key[first] for key in keys], axis=1), index


def read_obj(
    path: str | os.PathLike[str], emitting: Collection[str] = (), images: Images | None = None
) -> Geometry:
    """Read a Wavefront OBJ model: one part for each material, in the file's frame and unit.

    Args:
        path: of the file.
        emitting: materials that will emit, besides those that do so in the file.
        images: of several files that become one model. Default: of this file.

    Raises:
        LumitreeError: a file is missing, malformed or too large, or names what is outside the
            model's folder.
    """
    path = Path(path)
    file = parse_obj(path)
    folder = ObjFolder(path, images or Images())
    library = _library(file, folder)
    lit = [name for name, source in library.items() if source.emits]
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
        made, factor = material(title, source, mesh, folder)
        colours = None if mesh.colours is None or factor is None else mesh.colours * factor
        mesh = dataclasses.replace(mesh, colours=colours)
        pieces = by_handedness(mesh, made.normal_map is not None)
        for count, (piece, mirrored) in enumerate(pieces):
            used = made
            if mirrored and made.normal_map is not None:
                used = dataclasses.replace(
                    made,
                    name=titles.unique(f"{title} mirrored"),
                    normal_map=_mirrored(made.normal_map, folder.images),
                )
            materials[used.name] = used
            parts.append(Part(taken.unique(name) if count else name, piece, used.name))
    return Geometry(tuple(parts), tuple(materials.values()), tuple(folder.images.pixels))


def _mirrored(normal_map: Texture, images: Images) -> Texture:
    """A normal map with its second axis turned round."""
    pixels = images.pixels[normal_map.image].copy()
    pixels[..., 1] = 255 - pixels[..., 1]
    return dataclasses.replace(normal_map, image=images.add(pixels))


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
            # Images beside the MTL file, where that is in a folder below.
            maps = {
                key: dataclasses.replace(each, file=folder.name_beside(path, each.file))
                for key, each in entry.maps.items()
            }
            found.setdefault(name, dataclasses.replace(entry, maps=maps))
    return found


def part_names(titles: Iterable[str]) -> list[str]:
    """Distinct names, fit for files, made from any text."""
    names = Names("-")
    bases = (re.sub(r"[^A-Za-z0-9_-]+", "_", title)[:_MAX_NAME].strip("_") for title in titles)
    return [names.unique(base or _UNNAMED) for base in bases]
