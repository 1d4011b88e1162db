"""The meshes of Mitsuba as NumPy arrays; no other module uses the names of their buffers.

Arrays have the names of an asset's geometry: `vertices` [V, 3], `faces` [F, 3], and, if the mesh
has them, `normals` [V, 3], `texcoords` [V, 2] and `colours` [V, 3].

Mitsuba 3.10 replaces `mi.Mesh`. This is what changes here (its release notes have the rest):

* A mesh is made by `mi.Mesh(props)` and `from_fields(faces, positions, normals, texcoords)`, of
  tensors. A mesh without normals gets smooth ones, unless `props` has `face_normals`.
* `mi.traverse` has `positions`, `normals`, `texcoords` and `faces`, as have the methods that read
  them. Vertices share positions and normals: vertex i has `positions[position_index[i]]` and
  `normals[normal_index[i]]`, where these indices are not empty.
* `add_attribute` takes a tensor [V, 3] in place of a size and a flat array.
* `flip_normals`, and transforms that mirror, turn faces and normals round when a mesh is made. So
  `is_flipped` is always false, and copies of mirrored instances have their outside in front:
  `SceneFile.mirrored` and what depends on it can be deleted.
"""

from __future__ import annotations

from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.device import on_device
from lumitree.core.reading import Arrays

if TYPE_CHECKING:
    import mitsuba as mi

# The mesh attribute of vertex colours.
VERTEX_COLOUR = "vertex_color"
# Mitsuba's names of the arrays in `mi.traverse`, and their components.
VERTICES, NORMALS = "vertex_positions", "vertex_normals"
_BUFFERS = {
    "vertices": (VERTICES, 3),
    "faces": ("faces", 3),
    "normals": (NORMALS, 3),
    "texcoords": ("vertex_texcoords", 2),
}


def hidden_mesh_class() -> type[mi.Mesh]:
    """Class of meshes whose arrays `mi.traverse` does not show once `shown` is set.

    `shown` are the names of the methods that return objects which it shows.
    """
    import mitsuba as mi

    class HiddenMesh(mi.Mesh):
        shown: tuple[str, ...] | None = None

        def all_parameters(self):
            shown, self.shown = self.shown, None
            parameters, self.shown = mi.traverse(self), shown
            return parameters

        def traverse(self, callback):
            if self.shown is None:
                super().traverse(callback)
                return
            for name in self.shown:
                if (part := getattr(self, name)()) is not None:
                    callback.put(name, part, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"HiddenMesh[{self.id()}]"

    return HiddenMesh


def make_mesh(
    name: str,
    arrays: Mapping[str, ArrayLike | None],
    props: mi.Properties | None = None,
    made: type[mi.Mesh] | None = None,
) -> mi.Mesh:
    """A mesh of some arrays; those that are None or empty count as absent.

    Args:
        name: its id, if `props` has none.
        props: with BSDF, emitter and media as objects. Default: diffuse.
        made: class of the result. Default: mi.Mesh.
    """
    import mitsuba as mi

    given = {key: np.asarray(each) for key, each in arrays.items() if each is not None}
    given = {key: values for key, values in given.items() if values.size}
    mesh = (made or mi.Mesh)(
        name,
        len(given["vertices"]),
        len(given["faces"]),
        has_vertex_normals="normals" in given,
        has_vertex_texcoords="texcoords" in given,
        props=props or mi.Properties(),
    )
    if "colours" in given:
        mesh.add_attribute(VERTEX_COLOUR, 3, on_device(mi.Float, given.pop("colours")))
    change_mesh(mesh, given)
    return mesh


def copy_mesh(copy: mi.Mesh, mesh: mi.Mesh, props: mi.Properties) -> None:
    """Construct `copy`, in the constructor of a subclass of mi.Mesh, with the arrays of a mesh.

    They have to have normals and texture coordinates, and do not leave the device: plugins must not
    wait for it while they are created.
    """
    import mitsuba as mi

    mi.Mesh.__init__(
        copy,
        props.id(),
        mesh.vertex_count(),
        mesh.face_count(),
        has_vertex_normals=True,
        has_vertex_texcoords=True,
        props=props,
    )
    found, parameters = mi.traverse(mesh), mi.traverse(copy)
    for buffer, _ in _BUFFERS.values():
        parameters[buffer] = found[buffer]
    parameters.update()


def keep_apart(mesh: mi.Mesh) -> None:
    """Let Mitsuba not merge a mesh with others of its BSDF: it merges none with attributes."""
    import mitsuba as mi

    mesh.add_attribute("face_apart", 1, on_device(mi.Float, np.zeros(mesh.face_count())))


def change_mesh(mesh: mi.Mesh, arrays: Mapping[str, ArrayLike]) -> None:
    """Replace some arrays of a mesh, but for its colours.

    Without `normals` among them, Mitsuba derives normals from the vertices if the mesh has any.
    """
    import mitsuba as mi

    hidden = getattr(mesh, "all_parameters", None)
    parameters = hidden() if hidden else mi.traverse(mesh)
    for name, values in arrays.items():
        kind = mi.UInt32 if name == "faces" else mi.Float
        parameters[_BUFFERS[name][0]] = on_device(kind, values)
    parameters.update()


def mesh_arrays(mesh: mi.Shape) -> Arrays:
    """All arrays that a mesh has, float32 and uint32."""
    import mitsuba as mi

    found = {
        name: np.array(getattr(mesh, f"{buffer}_buffer")()).reshape(-1, components)
        for name, (buffer, components) in _BUFFERS.items()
    }
    found["colours"] = np.array(mi.traverse(mesh).get(VERTEX_COLOUR, [])).reshape(-1, 3)
    return {name: values for name, values in found.items() if values.size}


def mesh_vertices(mesh: mi.Mesh) -> NDArray[np.float64]:
    """Vertices [V, 3] of a mesh."""
    return np.array(mesh.vertex_positions_buffer(), np.float64).reshape(-1, 3)


def mesh_triangles(mesh: mi.Mesh) -> NDArray[np.float64]:
    """Corners [F, 3, 3] of the triangles of a mesh."""
    return mesh_vertices(mesh)[np.array(mesh.faces_buffer()).reshape(-1, 3)]


def is_flipped(mesh: Any) -> bool:
    """Whether the front of a mesh is opposite to its faces' order and its normals."""
    return mesh.has_flipped_normals()
