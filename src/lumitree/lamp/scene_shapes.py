"""The shapes of a scene as its file names them."""

from __future__ import annotations

import dataclasses
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, Protocol

from lumitree.core.backend import load_mitsuba
from lumitree.core.mitsuba_meshes import NORMALS, VERTICES
from lumitree.errors import shown

if TYPE_CHECKING:
    import mitsuba as mi

# Keys that Mitsuba gives to elements without a name begin so.
_UNNAMED = "_arg_"
# Class of Mitsuba that holds the shapes which instances repeat. `Scene.shapes` leaves it out.
_GROUP = "ShapeGroupPlugin"
# Parameters of shapes that stand for a change of their geometry. If vertices change and normals do
# not, Mitsuba would compute normals of its own.
_GEOMETRY = ["to_world", VERTICES, NORMALS, "control_points", "data"]
# How a shape is chosen, for messages; see `SceneShape.names`.
CHOSEN_BY = "shape's id, BSDF's id or number"


class SceneNodes(Protocol):
    """The nodes of a `SceneFile`, which imports this module."""

    def nodes(self, kind: str) -> list[mi.parser.SceneNode]: ...

    def children(self, props: mi.Properties) -> dict[str, mi.parser.SceneNode]: ...

    def bsdfs(self, props: mi.Properties) -> list[mi.parser.SceneNode]: ...


@dataclasses.dataclass(frozen=True)
class SceneShape:
    """A shape of a scene, or an instance of a group of shapes.

    Attributes:
        number: place among the shapes of the file, from 0; None if the scene was written from a
            model, whose shapes all have names.
        name: its id, or else the attribute `name` of its element, as in a scene that was written
            from a dictionary; empty if it has neither.
        kind: plugin of Mitsuba.
        materials: ids of its BSDF and of the BSDFs within it, as far as they have any.
        bsdf: plugin of its BSDF, and of the textures that this one names; empty if it has none.
        emitter: likewise.

    A `mi.Scene` has classes in place of plugins.
    """

    number: int | None
    name: str
    kind: str
    materials: tuple[str, ...]
    bsdf: str
    emitter: str

    def __str__(self) -> str:
        material = f", BSDF {shown(self.materials[0], 40)}" if self.materials else ""
        emits = ", emits" if self.emitter else ""
        number = "" if self.number is None else f"#{self.number} "
        return f"{number}{shown(self.name, 40) or '-'} ({self.kind}{material}{emits})"

    @property
    def names(self) -> tuple[str, ...]:
        """The names by which it is chosen."""
        return (self.name, *self.materials)

    @property
    def label(self) -> str:
        """Its id, or its number and kind, for messages."""
        return shown(repr(self.name), 60) if self.name else f"#{self.number} ({self.kind})"


def shape_of_node(number: int, key: str, node: mi.parser.SceneNode, file: SceneNodes) -> SceneShape:
    """The shape of a node of a `SceneFile`, before it is created.

    `key` is its key in the scene: the attribute `name`, or made by Mitsuba.
    """
    types = load_mitsuba().ObjectType
    children = file.children(node.props).values()
    return SceneShape(
        number=number,
        name=node.props.id() or ("" if key.startswith(_UNNAMED) else key),
        kind=node.props.plugin_name(),
        materials=tuple(i for each in file.bsdfs(node.props) if (i := each.props.id())),
        bsdf=", ".join(_described(file, each) for each in children if each.type == types.BSDF),
        emitter=", ".join(
            _described(file, each) for each in children if each.type == types.Emitter
        ),
    )


def shape_of_object(number: int, shape: mi.Shape) -> SceneShape:
    """The shape of a mi.Shape."""
    bsdf, emitter = shape.bsdf(), shape.emitter()
    return SceneShape(
        number=number,
        name=shape.id(),
        kind=shape.class_name(),
        materials=(bsdf.id(),) if bsdf is not None and bsdf.id() else (),
        bsdf="" if bsdf is None else bsdf.class_name(),
        emitter="" if emitter is None else emitter.class_name(),
    )


def reusable_shapes(scene: mi.Scene) -> list[mi.Shape]:
    """The shapes of a mi.Scene, for another one: also the groups that its instances repeat."""
    groups = shape_groups(scene)
    build_again(groups)
    return [*groups, *scene.shapes()]


def shape_groups(scene: mi.Scene) -> list[mi.Shape]:
    """The groups of shapes that the instances of a mi.Scene repeat."""
    return [child for child in _children(scene) if child.class_name() == _GROUP]


def build_again(groups: Sequence[mi.Shape]) -> None:
    """Let the next scene that is made of groups of shapes build them, although another one has.

    Under OptiX, Mitsuba 3.9 builds a group in the scene that first has it, and again only when its
    shapes change. Another scene would look in vain for what it has not built.
    """
    for group in groups:
        for shape in _children(group)[:1]:
            shape.parameters_changed(_GEOMETRY)
        group.parameters_changed([])


def _children(parent: mi.Object) -> list[Any]:
    mi = load_mitsuba()
    children = []

    class Children(mi.TraversalCallback):
        def put(self, name: str, value: object, *_: object) -> None:
            if isinstance(value, mi.Object):
                children.append(value)

    parent.traverse(Children())
    found = children.copy()
    # Only the garbage collector frees the class. If it held objects, these would be freed while
    # `dr.dispatch` calls them.
    children.clear()
    return found


def shapes_of_scene(scene: mi.Scene, shapes: Sequence[SceneShape]) -> Sequence[SceneShape]:
    """The shapes of a mi.Scene, taken from its file where they are the same."""
    made = scene.shapes()
    if len(made) == len(shapes):
        return shapes
    # A plugin, such as `merge`, has become several shapes.
    return [shape_of_object(*item) for item in enumerate(made)]


def _described(file: SceneNodes, node: mi.parser.SceneNode) -> str:
    textures = [
        child.props.plugin_name()
        for child in file.children(node.props).values()
        if child.type == load_mitsuba().ObjectType.Texture
    ]
    return node.props.plugin_name() + (f" with {', '.join(textures)}" if textures else "")


def referred(props: mi.Properties) -> dict[str, int]:
    """Indices of the nodes that a node refers to, by the names of the properties."""
    kind = load_mitsuba().Properties.Type.ResolvedReference
    return {key: props[key].index() for key in list(props.keys()) if props.type(key) == kind}
