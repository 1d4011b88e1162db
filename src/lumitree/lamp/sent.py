"""Luminaires for tasks in other processes, which load them again."""

import dataclasses
import functools
import os
import warnings
from concurrent.futures import Executor
from typing import Any

from lumitree.core.executor import packed, unpacked
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.lamp.builtin.registry import BUILTIN
from lumitree.lamp.luminaire import Luminaire, LuminaireLike
from lumitree.lamp.source import LuminaireSource


@dataclasses.dataclass(frozen=True)
class LampWorkers:
    """Workers that load a luminaire.

    Attributes:
        executor: of the workers.
        luminaire: for `received_luminaire`.
    """

    executor: Executor
    luminaire: bytes


def lamp_workers(
    executor: Executor | None, source: LuminaireLike, luminaire: Luminaire
) -> LampWorkers | None:
    """Workers that load a luminaire as this process did; None without an executor.

    Args:
        executor: of the workers.
        source: what `load_luminaire` was given.
        luminaire: what it returned.

    Raises:
        LumitreeError: the source cannot be sent to other processes.
    """
    if executor is None:
        return None
    sent = absolute_source(source), luminaire.fingerprint
    return LampWorkers(executor, packed(sent, luminaire.name, "its path"))


@functools.lru_cache(maxsize=1)
def received_luminaire(data: bytes) -> Luminaire:
    """The luminaire that was sent to this process; its warnings are given where it was sent.

    Raises:
        LumitreeError: its files differ from the files of the process that sent it.
    """
    source, fingerprint = unpacked(data)
    from lumitree.lamp.loading import load_luminaire

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LumitreeWarning)
        luminaire = load_luminaire(source)
    if luminaire.fingerprint != fingerprint:
        raise LumitreeError(
            f"{luminaire.name} differs between a worker and the process that sent the task; give "
            "all the same files, and do not change them meanwhile"
        )
    return luminaire


def absolute_source(source: Any) -> Any:
    """A source of light, or a scene, with absolute paths: workers may run in another folder.

    Raises:
        LumitreeError: it is a loaded luminaire.
    """
    if isinstance(source, Luminaire):
        raise LumitreeError(
            f"{source.name} is loaded already, and cannot be sent to other processes; give its "
            "name, its path, its LuminaireSource or its dictionary"
        )
    if isinstance(source, LuminaireSource):
        materials = None if source.materials is None else os.path.abspath(source.materials)
        return dataclasses.replace(source, name=absolute_source(source.name), materials=materials)
    if isinstance(source, str | os.PathLike) and os.fspath(source) not in BUILTIN:
        return os.path.abspath(source)
    return source
