"""Checkpoints of unfinished jobs: named arrays in a file, and the inputs that they belong to.

A checkpoint is written under a temporary name and renamed, so that a killed process leaves the one
before. A job continues only from a checkpoint with its own fingerprint: all inputs that its result
depends on. Equal seeds then give equal bytes after an interruption as without one.
"""

import json
import time
import warnings
from collections.abc import Callable, Iterator
from pathlib import Path

import numpy as np

from lumitree._version import __version__
from lumitree.core.files import WriteError, atomic_path
from lumitree.core.interruption import STATE_IS_KEPT
from lumitree.core.reading import Arrays, parse_json, read_arrays
from lumitree.core.tables import Table, check_table
from lumitree.errors import LumitreeError, LumitreeWarning, shown

# Files of all checkpoints in a work folder: of light field, octree fit, network and image.
CHECKPOINTS = ("light.npz", "octree.npz", "run/run.npz", "passes.npz")
# Name of the fingerprint among the arrays.
_FINGERPRINT = "fingerprint"
# Least time between two checkpoints, s, and the largest part of the time that saving them takes.
_SECONDS, _MOST_TIME = 30.0, 0.02
# Inputs that a message names.
_NAMED = 4


class OtherJobError(LumitreeError):
    """A checkpoint belongs to another job."""


class Checkpoint:
    """The checkpoint of one job.

    Args:
        path: its file, `.npz`.
        fingerprint: inputs of the job, as members of a JSON object.
        job: name of the kind of job, for messages, such as "bake".
    """

    def __init__(self, path: Path, fingerprint: Table, job: str) -> None:
        self._path, self._job = path, job
        self._fingerprint = parse_json(json.dumps({"lumitree": __version__, **fingerprint}))
        self._next, self._warned = time.monotonic() + _SECONDS, False

    @property
    def exists(self) -> bool:
        """Whether there is a file, of this job or of another."""
        return self._path.exists()

    def load(self) -> Arrays | None:
        """The arrays that were saved; None if there is no file.

        Raises:
            OtherJobError: the file belongs to another job; the message names inputs that differ.
            LumitreeError: it is damaged.
        """
        if not self.exists:
            return None
        found, arrays = read_checkpoint(self._path)
        if changed := list(_differences(found, self._fingerprint)):
            more = ", ..." if len(changed) > _NAMED else ""
            raise OtherJobError(
                f"{shown(self._path.parent, 300)} has an unfinished {self._job} with other inputs "
                f"({', '.join(changed[:_NAMED])}{more}); remove it, or choose another folder"
            )
        STATE_IS_KEPT.set()
        return arrays

    def save(self, arrays: Arrays) -> None:
        """Write the arrays.

        Raises:
            WriteError: the file cannot be written.
        """
        start = time.monotonic()
        text = np.array(json.dumps(self._fingerprint, sort_keys=True))
        with atomic_path(self._path) as temporary, open(temporary, "wb") as file:
            np.savez(file, **{_FINGERPRINT: text, **arrays})  # type: ignore[arg-type]
        STATE_IS_KEPT.set()
        now = time.monotonic()
        self._next = now + max(_SECONDS, (now - start) / _MOST_TIME)

    def try_save(self, arrays: Arrays) -> None:
        """As `save`, but warns, once, where that fails: the job itself can go on."""
        try:
            self.save(arrays)
            self._warned = False
        except WriteError as error:
            self._next = time.monotonic() + _SECONDS
            if not self._warned:
                self._warned = True
                warnings.warn(
                    f"cannot save the state of the {self._job} in "
                    f"{shown(self._path.parent, 300)}: {error.reason}; it goes on, but cannot be "
                    "continued if it is killed",
                    LumitreeWarning,
                    stacklevel=2,
                )

    def offer(self, arrays: Callable[[], Arrays]) -> None:
        """`try_save` the arrays that a function returns, if that was not done for a while."""
        if time.monotonic() >= self._next:
            self.try_save(arrays())


def read_checkpoint(path: Path) -> tuple[Table, Arrays]:
    """The fingerprint and the arrays of a checkpoint of any job.

    Raises:
        LumitreeError: the file is missing or damaged.
    """
    try:
        arrays = read_arrays(path)
        if _FINGERPRINT not in arrays:
            raise LumitreeError(f"{shown(path, 300)} is no checkpoint of lumitree")
        fingerprint = check_table(parse_json(str(arrays.pop(_FINGERPRINT))))
    except LumitreeError as error:
        raise LumitreeError(f"{error}; remove it to start again") from None
    return fingerprint, arrays


def _differences(found: object, wanted: object, name: str = "") -> Iterator[str]:
    """Texts that name the members in which two JSON values differ."""
    if isinstance(found, dict) and isinstance(wanted, dict):
        for key in sorted({*found, *wanted}):
            inner = f"{name}.{key}" if name else key
            yield from _differences(found.get(key), wanted.get(key), inner)
    elif found != wanted:
        simple = all(isinstance(each, str | int | float | None) for each in (found, wanted))
        short = simple and len(f"{found}{wanted}") < 60
        yield f"{name} {shown(str(found))} -> {shown(str(wanted))}" if short else name
