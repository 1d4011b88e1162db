"""The shape `lumitree_box`: the proxy of a lamp, without parameters of its own.

`mitsuba.traverse` shows the vertices of Mitsuba's `cube`. A lamp would not follow them.
"""

from __future__ import annotations

import mitsuba as mi

from lumitree.core.mitsuba_meshes import copy_mesh
from lumitree.rendering.plugins.objects import make_object


def box_class() -> type:
    """Class of the shape for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeBox(mi.Mesh):
        _made = False

        def __init__(self, props: mi.Properties) -> None:
            copy_mesh(self, make_object("cube", {"to_world": props["to_world"]}), props)
            self._made = True

        def traverse(self, callback):
            if self._made:
                callback.put("emitter", self.emitter(), mi.ParamFlags.Differentiable)
            else:
                super().traverse(callback)

        def to_string(self) -> str:
            return "LumitreeBox[]"

    return LumitreeBox
