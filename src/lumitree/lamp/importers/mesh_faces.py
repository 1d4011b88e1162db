"""Some of a mesh's faces, both sides of them, and surfaces with vertex colours."""

import dataclasses
from collections.abc import Iterator

import numpy as np
from numpy.typing import NDArray

from lumitree.lamp.meshes import Mesh, areas_on_image
from lumitree.lamp.parts import Diffuse, Principled, Surface, VertexColour


def selected(mesh: Mesh, keep: NDArray[np.bool_]) -> Mesh:
    """The faces that `keep` [F] marks, with the vertices they use."""
    used, faces = np.unique(mesh.faces[keep], return_inverse=True)
    return Mesh(
        mesh.vertices[used],
        mesh.normals[used],
        faces.reshape(-1, 3),
        None if mesh.uv is None else mesh.uv[used],
        None if mesh.colours is None else mesh.colours[used],
    )


def with_backs(mesh: Mesh, doubled: NDArray[np.bool_], distance: float) -> Mesh:
    """The mesh and a second, reversed copy of the faces that `doubled` [F] marks.

    A surface emits from its front alone; with its copy it emits from both sides. With two faces in
    one place a ray would hit either, so the copy lies behind by a distance in the mesh's unit.
    """
    back = selected(mesh, doubled)
    vertices = back.vertices - distance * back.normals
    back = dataclasses.replace(
        back, vertices=vertices, normals=-back.normals, faces=back.faces[:, ::-1]
    )
    return Mesh(
        np.concatenate([mesh.vertices, back.vertices]),
        np.concatenate([mesh.normals, back.normals]),
        np.concatenate([mesh.faces, back.faces + len(mesh.vertices)]),
        None if mesh.uv is None or back.uv is None else np.concatenate([mesh.uv, back.uv]),
        None
        if mesh.colours is None or back.colours is None
        else np.concatenate([mesh.colours, back.colours]),
    )


def by_handedness(mesh: Mesh, bumpy: bool) -> Iterator[tuple[Mesh, bool]]:
    """The faces whose texture coordinates are mirrored apart from the others, if a mesh is bumpy.

    The second axis of normal maps is turned round there. Mitsuba's is the product of the normal and
    the first axis.
    """
    if not bumpy or mesh.uv is None:
        yield mesh, False
        return
    mirrored = areas_on_image(mesh.uv, mesh.faces) > 0
    for side in (False, True):
        if (mirrored == side).any():
            yield selected(mesh, mirrored == side), side


def painted(surface: Surface) -> Surface | None:
    """The surface with the colours of its mesh's vertices; None for one that has no such colour."""
    match surface:
        case Diffuse():
            return Diffuse(VertexColour())
        case Principled():
            return dataclasses.replace(surface, base_color=VertexColour())
        case _:
            return None
