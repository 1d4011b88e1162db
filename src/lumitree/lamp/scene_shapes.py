"""The shapes of a scene as its file names them, and their first evaluation.

Some plugins accept when they are created what they cannot evaluate: a bump map of a procedural
texture, or a curve that emits. `check_evaluates` finds Mitsuba's exceptions. Nothing is compiled:
the functions of the plugins run, and their results are dropped.
"""

from __future__ import annotations

import dataclasses
import warnings
from collections.abc import Callable, Iterator, Sequence
from typing import TYPE_CHECKING, Any

from lumitree.core.backend import load_mitsuba
from lumitree.core.mitsuba_meshes import NORMALS, VERTICES
from lumitree.errors import LumitreeError, LumitreeWarning, renderer_reason, shown

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
        attributes: names of the mesh attributes that its BSDF and its emitter use.

    A `mi.Scene` has classes in place of plugins.
    """

    number: int | None
    name: str
    kind: str
    materials: tuple[str, ...]
    bsdf: str
    emitter: str
    attributes: tuple[str, ...] = ()

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


def shape_of_node(number: int, key: str, node: Any, file: Any) -> SceneShape:
    """The shape of a node of a `SceneFile`, before it is created.

    `key` is its key in the scene: the attribute `name`, or made by Mitsuba.
    """
    types = load_mitsuba().ObjectType
    children = file.children(node.props).values()
    return SceneShape(
        number=number,
        name=node.props.id() or ("" if key.startswith(_UNNAMED) else key),
        kind=node.props.plugin_name(),
        materials=tuple(
            each.props.id()
            for each in file.within(node.props, "BSDF")
            if each.type == types.BSDF and each.props.id()
        ),
        bsdf=", ".join(_described(file, each) for each in children if each.type == types.BSDF),
        emitter=", ".join(
            _described(file, each) for each in children if each.type == types.Emitter
        ),
        attributes=tuple(
            str(each.props.get("name", ""))
            for each in file.within(node.props, "BSDF", "Emitter")
            if each.props.plugin_name() == "mesh_attribute"
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
        def put(self, name: str, value: Any, *_: Any) -> None:
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


def _described(file: Any, node: Any) -> str:
    textures = [
        child.props.plugin_name()
        for child in file.children(node.props).values()
        if child.type == load_mitsuba().ObjectType.Texture
    ]
    return node.props.plugin_name() + (f" with {', '.join(textures)}" if textures else "")


def check_evaluates(
    scene: mi.Scene, shapes: Sequence[SceneShape], where: str, *, rays: bool = True
) -> None:
    """Refuse a scene with a BSDF or an emitter that Mitsuba cannot evaluate to numbers.

    Warns of mesh attributes that a shape lacks.

    Args:
        scene: mi.Scene.
        shapes: of the file that the scene was made from.
        where: name of the scene, for messages.
        rays: whether rays are also sampled from emitters, as for light paths.

    Raises:
        LumitreeError: the message names the shape, the plugin, and Mitsuba's reason.
    """
    tried: dict[int, Any] = {}
    described = shapes_of_scene(scene, shapes)
    for shape, names in zip(scene.shapes(), described, strict=True):
        bsdf, emitter = shape.bsdf(), shape.emitter()
        if bsdf is not None and id(bsdf) not in tried:
            what = f"the BSDF of shape {names.label}, {names.bsdf or bsdf.class_name()},"
            _try(_bsdf_calls(bsdf, shape), f"{where}: {what}")
            # Kept: another object could get the number of one that is freed.
            tried[id(bsdf)] = bsdf
        if emitter is not None:
            what = f"the emitter of shape {names.label}, {names.emitter or emitter.class_name()},"
            _try(_emitter_calls(emitter, shape, rays), f"{where}: {what}")
        for name in names.attributes:
            if not all(shape.has_attribute(name)):
                warnings.warn(
                    f"{where}: shape {names.label} has no attribute {shown(name, 60)!r}, which its "
                    "BSDF or emitter uses; it is 0 there",
                    LumitreeWarning,
                    stacklevel=3,
                )
    for emitter in scene.emitters():
        if emitter.get_shape() is None:
            what = f"{where}: the emitter {emitter.id() or emitter.class_name()}"
            _try(_emitter_calls(emitter, None, False), what)


def _try(calls: Iterator[Callable[[], Any]], what: str) -> None:
    for call in calls:
        try:
            call()
        except RuntimeError as error:
            reason = renderer_reason(error)
            if reason is None:
                raise
            raise LumitreeError(
                f"{what} cannot be evaluated by Mitsuba in {load_mitsuba().variant()}: "
                f"{shown(reason, 300)}; replace it, or its texture or shape; images and colours as "
                "textures, and meshes and spheres as shapes can be evaluated"
            ) from error


def _bsdf_calls(bsdf: mi.BSDF, shape: mi.Shape) -> Iterator[Callable[[], Any]]:
    mi = load_mitsuba()
    context, out = mi.BSDFContext(), mi.Vector3f(0, 0, 1)
    si = _point(shape)
    yield lambda: bsdf.eval(context, si, out)
    yield lambda: bsdf.pdf(context, si, out)
    yield lambda: bsdf.sample(context, si, mi.Float(0.5), mi.Point2f(0.5))
    yield lambda: bsdf.eval_null_transmission(si)


def _emitter_calls(
    emitter: mi.Emitter, shape: mi.Shape | None, rays: bool
) -> Iterator[Callable[[], Any]]:
    # Not at the top: Dr.Jit looks for its library when it is imported.
    import drjit as dr

    mi = load_mitsuba()
    si, seen_from = _point(shape), dr.zeros(mi.Interaction3f)
    seen_from.p = mi.Point3f(1, 2, 3)
    half = mi.Point2f(0.5)
    yield lambda: emitter.eval(si)
    yield lambda: emitter.sample_direction(seen_from, half)
    yield lambda: emitter.pdf_direction(seen_from, dr.zeros(mi.DirectionSample3f))
    if rays:
        yield lambda: emitter.sample_ray(0, mi.Float(0.5), half, half)


def _point(shape: mi.Shape | None) -> Any:
    """A mi.SurfaceInteraction3f that is seen from the front."""
    import drjit as dr

    mi = load_mitsuba()
    si = dr.zeros(mi.SurfaceInteraction3f)
    si.wi, si.n = mi.Vector3f(0, 0, 1), mi.Normal3f(0, 0, 1)
    si.sh_frame = mi.Frame3f(mi.Vector3f(0, 0, 1))
    si.dp_du, si.dp_dv = mi.Vector3f(1, 0, 0), mi.Vector3f(0, 1, 0)
    if shape is not None:
        si.shape = mi.ShapePtr(shape)
    return si


def referred(props: mi.Properties) -> dict[str, int]:
    """Indices of the nodes that a node refers to, by the names of the properties."""
    kind = load_mitsuba().Properties.Type.ResolvedReference
    return {key: props[key].index() for key in list(props.keys()) if props.type(key) == kind}
