"""Reading Mitsuba scene files, with errors that a user can act on."""

import contextlib
import os
import re
from collections.abc import Iterator
from pathlib import Path
from typing import Any

from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeError


class SceneFile:
    """A parsed Mitsuba 3 scene file whose objects have not been created yet."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        """Parse `path`.

        Raises:
            LumitreeError: the file is missing or is not a Mitsuba scene.
        """
        self.path = Path(path)
        if not self.path.is_file():
            raise LumitreeError(f"{path} does not exist; expected a Mitsuba 3 scene (.xml)")
        mi = load_mitsuba()
        self._config = mi.parser.ParserConfig(mi.variant())
        # Shapes stay as the file names them, and unused parameters are the file's own business.
        self._config.merge_meshes = False
        self._config.unused_parameters = mi.LogLevel.Debug
        with self._readable():
            self._state = mi.parser.parse_file(self._config, str(self.path))
            mi.parser.transform_all(self._config, self._state)

    def nodes(self, kind: str) -> list[Any]:
        """Nodes of a type of Mitsuba object, such as "Shape" or "Emitter"."""
        kind = getattr(load_mitsuba().ObjectType, kind)
        return [node for node in self._state.nodes if node.type == kind]

    def references(self) -> list[Path]:
        """Files that the scene names, each where it was found."""
        names = (
            node.props["filename"]
            for node in self._state.nodes
            if node.props.has_property("filename")
        )
        with self._searching() as resolver:
            return sorted({Path(str(resolver.resolve(name))) for name in names})

    def instantiate(self) -> Any:
        """Create the scene.

        Raises:
            LumitreeError: a mesh, texture or plugin it names is missing or damaged.
        """
        mi = load_mitsuba()
        with self._searching(), self._readable():
            scene = mi.parser.instantiate(self._config, self._state)
        if not isinstance(scene, mi.Scene):
            raise LumitreeError(f"{self.path} does not hold a <scene>; found {type(scene)}")
        return scene

    @contextlib.contextmanager
    def _searching(self) -> Iterator[Any]:
        """Resolve relative names against the scene's own folder, only within the block."""
        mi = load_mitsuba()
        before = mi.file_resolver()
        resolver = mi.FileResolver(before)
        resolver.prepend(mi.filesystem.path(str(self.path.resolve().parent)))
        mi.set_file_resolver(resolver)
        try:
            yield resolver
        finally:
            mi.set_file_resolver(before)

    @contextlib.contextmanager
    def _readable(self) -> Iterator[None]:
        try:
            yield
        except RuntimeError as error:
            # What our own plugins raise arrives inside a traceback; Mitsuba's own messages begin
            # with a place in its source.
            own = re.search(r"LumitreeError: (.*)", str(error))
            reason = own.group(1) if own else " ".join(str(error).split())
            reason = re.sub(r"\[\w+\.(cpp|h):\d+\] ", "", reason)
            raise LumitreeError(f"{self.path} cannot be loaded: {reason}") from None
