"""Reading of Mitsuba scene files and of dictionaries that describe scenes."""

from __future__ import annotations

import contextlib
import copy
import importlib
import os
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, NoReturn

import numpy as np
from numpy.typing import NDArray

from lumitree.core.backend import load_mitsuba, second_thread
from lumitree.core.device import transforms_as_parameters
from lumitree.core.file_kinds import SCENE, XML, what_it_is
from lumitree.core.frames import similarity
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, renderer_reason, shown
from lumitree.lamp.importers.model_files import MAX_MODEL_BYTES
from lumitree.lamp.media import keep_clear_channels
from lumitree.lamp.parts import select_names
from lumitree.lamp.scene_shapes import CHOSEN_BY, SceneShape, referred, shape_of_node
from lumitree.lamp.spectra import replace_blackbodies, spectra_of_emitters

if TYPE_CHECKING:
    import mitsuba as mi


def copy_instances(state: mi.parser.ParserState) -> frozenset[int]:
    """Replace the instances of a parsed scene by copies, which are placed in double precision.

    `state` is mi.parser.ParserState, after `transform_all`. Returns numbers of the nodes that are
    copies of mirrored instances: Mitsuba turns the normals of a mesh whose own transform mirrors
    it, but not the normals of a mirrored instance.
    """
    mi = load_mitsuba()
    root = state.nodes[0].props
    groups, copies, mirrored = [], [], set[int]()
    for key, index in referred(root).items():
        props = state.nodes[index].props
        match props.plugin_name():
            case "shapegroup":
                groups.append(key)
            case "instance":
                (group,) = referred(props).values()
                members = referred(state.nodes[group].props).values()
                copies.append((key, members, matrix_of(props)))
    for key, members, matrix in copies:
        for member in members:
            node, copied = state.nodes[member], mi.parser.SceneNode()
            copied.type, copied.props = node.type, mi.Properties(node.props)
            copied.file_index, copied.offset = node.file_index, node.offset
            place = matrix @ matrix_of(node.props)
            copied.props["to_world"] = mi.ScalarTransform4d(place)
            number = len(state.nodes)
            if np.linalg.det(matrix[:3, :3]) < 0:
                mirrored.add(number)
            # The list of nodes may move in memory: what was taken from it is not used after this.
            state.nodes.append(copied)
            state.nodes[0].props[f"_arg_copy_{number}"] = mi.Properties.ResolvedReference(number)
        del state.nodes[0].props[key]
    for key in groups:
        del state.nodes[0].props[key]
    return frozenset(mirrored)


def matrix_of(props: mi.Properties) -> NDArray[np.float64]:
    """[4, 4] of the transform of a shape; Mitsuba refuses properties of other types."""
    return np.array(getattr(props.get("to_world", None), "matrix", np.eye(4)), np.float64)


def register_metallic_roughness() -> None:
    """Register the BSDF of models with the variant of Mitsuba that is set."""
    load_mitsuba()
    # It imports Mitsuba, which a variant has to be set for.
    importlib.import_module("lumitree.lamp.metallic_roughness").register()


def refuse_kind(source: object, what: str) -> NoReturn:
    """Refuse `what`, "a scene" or "a luminaire", that is neither a name nor a dictionary."""
    kind = type(source)
    if kind.__name__ == "Scene" and kind.__module__.startswith("mitsuba"):
        raise LumitreeError(
            "the scene was created in another variant of Mitsuba than "
            f"{load_mitsuba().variant()}, which is set; create it in this one"
        )
    raise LumitreeError(
        f"{what} is a name, path, dictionary or mitsuba.Scene, not of type {kind.__name__}"
    )


class SceneFile:
    """A parsed Mitsuba 3 scene, whose objects can be created any number of times."""

    def __init__(
        self,
        source: str | os.PathLike[str] | Mapping[str, Any],
        keep: Sequence[str] = (),
        drop: Sequence[str] = (),
        folder: object = None,
    ) -> None:
        """Parse `source`.

        Args:
            source: path of a scene file, or a dictionary as for `mitsuba.load_dict`. Nothing is
                known about objects in a dictionary that are created already.
            keep: patterns with * and ? of ids of shapes or of their BSDFs, or numbers of shapes
                such as "#3". If there are any, all other shapes are left out of the scene, and all
                objects that are not shapes.
            drop: patterns or numbers of shapes that are left out.
            folder: what is kept as long as this object, because the file lasts as long.

        Raises:
            LumitreeError: the file is missing or is not a Mitsuba scene, or a pattern matches no
                shape.
        """
        if not isinstance(source, str | os.PathLike | Mapping):
            refuse_kind(source, "a scene")
        self._kept = folder
        # Numbers of nodes, from `copy_instances`.
        self._mirrored: frozenset[int] = frozenset()
        # Relative names in a dictionary start in the working folder.
        self.path, self._folder, self._name = Path(), Path(), "the scene's dictionary"
        if not isinstance(source, Mapping):
            self.path = Path(source)
            self._folder, self._name = self.path.parent, shown(source, 300)
            content = read_bytes(self.path, "a Mitsuba scene", MAX_MODEL_BYTES)
            if (what := what_it_is(self.path, content)) not in (None, SCENE, XML):
                raise LumitreeError(f"{self._name} is {what}; expected a Mitsuba 3 scene (.xml)")
        mi = load_mitsuba()
        register_metallic_roughness()
        # Compared for each property of each node.
        self._types = mi.ObjectType
        self._config = mi.parser.ParserConfig(mi.variant())
        # Shapes keep the ids of the file; unused parameters are not reported.
        self._config.merge_meshes = self._config.merge_equivalent = False
        self._config.unused_parameters = mi.LogLevel.Debug
        # Files of spectra are read here.
        with self._searching(), self._readable():
            self._state = (
                mi.parser.parse_dict(self._config, dict(source))
                if isinstance(source, Mapping)
                else mi.parser.parse_file(self._config, str(source))
            )
            mi.parser.transform_all(self._config, self._state)
        # Shapes of the scene by their keys. A group is only visible through its instances.
        root = self._state.nodes[0].props
        nodes = {
            key: node
            for key, node in self.children(root).items()
            if self._is_a(node, "Shape") and not self._is_group(node)
        }
        self._shapes = {
            key: shape_of_node(number, key, nodes[key], self)
            for number, key in enumerate(sorted(nodes, key=lambda key: root[key].index()))
        }
        if keep or drop:
            self._select(keep, drop)
        # Last, because equal BSDFs become one, with one id.
        mi.parser.transform_merge_equivalent(self._config, self._state)
        # Spectra of emitters, by their ids.
        self.spectra = spectra_of_emitters(self)
        # Properties read in another way than by Mitsuba; one line each.
        self.notes = replace_blackbodies(self)

    def _select(self, keep: Sequence[str], drop: Sequence[str]) -> None:
        root = self._state.nodes[0].props
        children = self.children(root)
        shapes = list(self._shapes.values())
        names = [shape.names for shape in shapes]
        chosen = select_names(names, keep, drop, self._name, CHOSEN_BY, list(map(str, shapes)))
        kept = {key for key, wanted in zip(self._shapes, chosen, strict=True) if wanted}
        groups = {key for key, node in children.items() if self._is_group(node)}
        if not keep:
            kept |= children.keys() - groups - self._shapes.keys()
        # A group is kept if an instance of it is.
        visible = {index for key in kept for index in referred(children[key].props).values()}
        kept |= {key for key in groups if root[key].index() in visible}
        for key in children.keys() - kept:
            del root[key]
        self._shapes = {key: shape for key, shape in self._shapes.items() if key in kept}

    @property
    def shapes(self) -> tuple[SceneShape, ...]:
        """Shapes and instances of the scene, in the order of the file."""
        return tuple(self._shapes.values())

    def loose_lights(self) -> list[str]:
        """Plugins of the emitters that no shape has."""
        held = {index for node in self.nodes("Shape") for index in referred(node.props).values()}
        loose = (self._state.nodes[index] for index in sorted(self._reached({0}) - held))
        return [node.props.plugin_name() for node in loose if self._is_a(node, "Emitter")]

    def nodes(self, kind: str) -> list[mi.parser.SceneNode]:
        """Nodes of one type of Mitsuba object, such as "Shape" or "Emitter"."""
        return [node for node in self._used() if self._is_a(node, kind)]

    def children(self, props: mi.Properties) -> dict[str, mi.parser.SceneNode]:
        """Nodes that a node's properties refer to, by the names of the properties."""
        return {name: self._state.nodes[index] for name, index in referred(props).items()}

    def bsdfs(self, props: mi.Properties) -> list[mi.parser.SceneNode]:
        """The BSDF that a shape refers to, and all within it, each once."""
        nodes = self._state.nodes
        start = {i for i in referred(props).values() if self._is_a(nodes[i], "BSDF")}
        return [nodes[i] for i in sorted(self._reached(start)) if self._is_a(nodes[i], "BSDF")]

    def set_rgb_films(self) -> None:
        """Make all films store R, G and B, and nothing else."""
        for film in self.nodes("Film"):
            if film.props.plugin_name() == "hdrfilm":
                film.props["pixel_format"] = "rgb"

    def set_box_filter(self) -> None:
        """Make the reconstruction filter of all sensors a box, so that pixels share no samples."""
        mi = load_mitsuba()
        box = mi.load_dict({"type": "box"})
        for sensor in self.nodes("Sensor"):
            films = [n for n in self.children(sensor.props).values() if self._is_a(n, "Film")]
            if not films:
                film = {"type": "hdrfilm", "rfilter": {"type": "box"}}
                sensor.props["film"] = mi.load_dict(film)
            for film in films:
                for name, node in self.children(film.props).items():
                    if self._is_a(node, "ReconstructionFilter"):
                        del film.props[name]
                film.props["rfilter"] = box

    def moved(self, matrix: NDArray[np.float64]) -> SceneFile:
        """The scene with all shapes moved by a similarity transform [4, 4], in double precision."""
        transform, found = load_mitsuba().ScalarTransform4d, self._copy()
        for props in found._placed_shapes():
            # The parser keeps transforms in double precision.
            props["to_world"] = transform(matrix @ matrix_of(props))
        return found

    def without_instances(self) -> SceneFile:
        """The scene with copies of the shapes of groups in place of their instances."""
        found = self._copy()
        found._mirrored = copy_instances(found._state)
        return found

    def mirrored(self) -> list[bool]:
        """Whether each node of `nodes("Shape")` is a copy of a mirrored instance."""
        numbers = sorted(self._reached({0}))
        shapes = [each for each in numbers if self._is_a(self._state.nodes[each], "Shape")]
        return [each in self._mirrored for each in shapes]

    def _copy(self) -> SceneFile:
        found = copy.copy(self)
        found._state = load_mitsuba().parser.ParserState(self._state)
        return found

    def recentred(self, origin: NDArray[np.float64]) -> SceneFile:
        """The scene whose coordinates have their origin at [3] `origin`, in double precision.

        The points by which spheres and cylinders are placed become a part of their transform.
        Vertices of mesh files are read as float32, and stay what they are.
        """
        mi, found = load_mitsuba(), self._copy()
        transform = mi.ScalarTransform4d
        for props in found._placed_shapes():
            place = _numbers(props, ("center", "p0"), np.full(3, np.nan))
            if np.isnan(place).any():
                continue
            for name in {"center", "p0", "p1"} & set(props.keys()):
                props[name] = mi.ScalarPoint3d(_numbers(props, (name,), place) - place)
            props["to_world"] = transform(matrix_of(props) @ similarity(np.eye(3), 1.0, place))
        return found.moved(similarity(np.eye(3), 1.0, -np.asarray(origin)))

    def analytic_box(self) -> NDArray[np.float64]:
        """[2, 3] a box around the shapes that are no files, in double precision; NaN for none."""
        corners = [np.full((2, 3), np.nan)]
        for props in self._placed_shapes():
            if "filename" in props or props.plugin_name() in ("instance", "merge"):
                continue
            matrix = matrix_of(props)
            place = _numbers(props, ("center", "p0"), np.zeros(3))
            length = np.linalg.norm(_numbers(props, ("p1",), place) - place)
            radius = _numbers(props, ("radius",), np.ones(()))
            reach = max(length, float(radius)) * np.linalg.norm(matrix[:3, :3], axis=0)
            centre = matrix[:3, :3] @ place + matrix[:3, 3]
            corners.append(centre + np.outer([-1, 1], np.full(3, reach.max())))
        box = np.array(corners)
        return np.stack([np.fmin.reduce(box[:, 0]), np.fmax.reduce(box[:, 1])])

    def _placed_shapes(self) -> list[mi.Properties]:
        """Properties of the shapes whose transform is the scene's own.

        Shapes of a group are placed by its instances.
        """
        shapes = [node.props for node in self.nodes("Shape")]
        groups = [props for props in shapes if props.plugin_name() == "shapegroup"]
        grouped = [node.props for group in groups for node in self.children(group).values()]
        return [p for p in shapes if not any(p is other for other in (*groups, *grouped))]

    def resolve(self, name: str) -> Path:
        """Path of a file that the scene refers to."""
        with self._searching() as resolver:
            return Path(str(resolver.resolve(name)))

    def _used(self) -> list[mi.parser.SceneNode]:
        """Nodes that belong to the scene, directly or within others, in the order of the file."""
        return [self._state.nodes[index] for index in sorted(self._reached({0}))]

    def _reached(self, start: set[int]) -> set[int]:
        """Indices of nodes and of all that they refer to, directly or within others."""
        found, waiting = set(start), list(start)
        while waiting:
            inner = set(referred(self._state.nodes[waiting.pop()].props).values())
            waiting += inner - found
            found |= inner
        return found

    def parsed_text(self) -> str:
        """The scene as its file describes it, as XML: with the parts that it includes."""
        parser = load_mitsuba().parser
        with self._searching(), self._readable():
            return parser.write_string(parser.parse_file(self._config, str(self.path)))

    def listed_spectra(self) -> Iterator[NDArray[np.float64]]:
        """Wavelengths and values of all spectra of the scene, also of those that files list."""
        kind = load_mitsuba().Properties.Type.Spectrum
        for props in (node.props for node in self._used()):
            for name in list(props.keys()):
                if props.type(name) == kind:
                    yield np.array([*props[name].wavelengths, *props[name].values], np.float64)

    def references(self) -> list[Path]:
        """Paths of the files that the scene refers to."""
        names = {node.props.get("filename", None) for node in self._used()}
        # Mitsuba takes no other values for files, such as a spectrum of this name.
        return sorted({self.resolve(name) for name in names if isinstance(name, str)})

    def instantiate(self) -> mi.Scene:
        """Create the scene; the parsed file stays as it is.

        Raises:
            LumitreeError: a mesh, texture or plugin of the scene is missing or damaged.
        """
        mi = load_mitsuba()
        has_media = bool(self.nodes("Medium"))
        # Lamps would be created within each other, by tasks that wait.
        lamps = (node.props.plugin_name() == "lumitree_proxy" for node in self._used())
        self._config.parallel = not any(lamps)
        # Creating a scene clears the nodes.
        from lumitree.lamp.emitting_surfaces import complete_textured_areas, replace_textured_areas

        state = mi.parser.ParserState(self._state)
        replace_textured_areas(state)
        with self._searching(), self._readable(), second_thread():
            scene = mi.parser.instantiate(self._config, state)
            if not isinstance(scene, mi.Scene):
                raise LumitreeError(f"{self._name} does not hold a <scene>; found {type(scene)}")
            complete_textured_areas(scene)
        transforms_as_parameters(scene.shapes())
        if has_media:
            keep_clear_channels(scene)
        return scene

    @contextlib.contextmanager
    def _searching(self) -> Iterator[mi.FileResolver]:
        """Context in which relative names are resolved against the folder of the scene file."""
        mi = load_mitsuba()
        before = mi.file_resolver()
        resolver = mi.FileResolver(before)
        resolver.prepend(mi.filesystem.path(str(self._folder.resolve())))
        mi.set_file_resolver(resolver)
        try:
            yield resolver
        finally:
            mi.set_file_resolver(before)

    @contextlib.contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except (RuntimeError, UnicodeError) as error:
            reason = renderer_reason(error) or " ".join(str(error).split())
            raise LumitreeError(f"{self._name} cannot be loaded: {shown(reason, 400)}") from None

    def _is_a(self, node: mi.parser.SceneNode, kind: str) -> bool:
        return node.type == getattr(self._types, kind)

    def _is_group(self, node: mi.parser.SceneNode) -> bool:
        return self._is_a(node, "Shape") and node.props.plugin_name() == "shapegroup"


def _numbers(
    props: mi.Properties, names: Sequence[str], default: NDArray[np.float64]
) -> NDArray[np.float64]:
    """The first of some properties that there is, if it has the shape of `default`."""
    found = next((props[name] for name in names if name in props), default)
    try:
        value = np.array(found, np.float64)
    except (TypeError, ValueError):
        return default
    return value if value.shape == default.shape else default
