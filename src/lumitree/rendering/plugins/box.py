"""The shape `lumitree_box`: the proxy of a lamp, without parameters of its own.

`mitsuba.traverse` shows the vertices of Mitsuba's `cube`. A lamp would not follow them.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.rendering.plugins.objects import make_object

_BUFFERS = ("faces", "vertex_positions", "vertex_normals", "vertex_texcoords")


def box_class() -> type:
    """Class of the shape for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeBox(mi.Mesh):
        _made = False

        def __init__(self, props: mi.Properties) -> None:
            cube = mi.traverse(make_object("cube", {"to_world": props["to_world"]}))
            super().__init__(
                props.id(),
                dr.width(cube["vertex_positions"]) // 3,
                dr.width(cube["faces"]) // 3,
                has_vertex_normals=True,
                has_vertex_texcoords=True,
                props=props,
            )
            parameters = mi.traverse(self)
            for name in _BUFFERS:
                parameters[name] = cube[name]
            parameters.update()
            self._made = True

        def traverse(self, callback):
            if self._made:
                callback.put("emitter", self.emitter(), mi.ParamFlags.Differentiable)
            else:
                super().traverse(callback)

        def to_string(self) -> str:
            return "LumitreeBox[]"

    return LumitreeBox
