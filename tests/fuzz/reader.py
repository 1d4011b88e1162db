"""What a reader is, and what has to hold for each input."""

import dataclasses
import traceback
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from support.damage import checked

MEBIBYTE = 1 << 20
# Of accepted inputs, which are used in full: rendered, or baked.
FULL_SHARE = 1 / 1000


def nothing(_: Any) -> None:
    """For readers whose values need no check."""


@dataclasses.dataclass(frozen=True)
class Reader:
    """A reader of files.

    Attributes:
        name: for the command.
        make: takes a random generator, and returns the content of the files of an input by name.
        read: takes the folder of the files; what it returns is what was read.
        use: takes what was read, and fails if it is not sound.
        use_in_full: the same, for a small part of all inputs: it takes long.
        memory: bytes that one input may take at most, besides what the program has.
        at_once: inputs of one process.
        in_suite: inputs of the default tests.
        full_share: part of the accepted inputs that are used in full.
    """

    name: str
    make: Callable[[np.random.Generator], dict[str, bytes]]
    read: Callable[[Path], Any]
    use: Callable[[Any], None] = nothing
    use_in_full: Callable[[Any], None] = nothing
    memory: int = 1024 * MEBIBYTE
    at_once: int = 2000
    in_suite: int = 40
    full_share: float = FULL_SHARE


@dataclasses.dataclass(frozen=True)
class Outcome:
    """What one input led to.

    Attributes:
        kind: "accepted", "full" (accepted, and used in full), "refused" or "failed".
        message: why it was refused, or what failed.
        detail: traceback of a failure.
    """

    kind: str
    message: str = ""
    detail: str = ""


def generator(name: str, seed: int, number: int) -> np.random.Generator:
    """The random numbers of an input."""
    return np.random.default_rng([zlib.crc32(name.encode()), seed, number])


def write_input(reader: Reader, seed: int, number: int, folder: Path) -> np.random.Generator:
    """Write the files of an input into a folder; returns its random numbers."""
    rng = generator(reader.name, seed, number)
    for name, content in reader.make(rng).items():
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(content)
    return rng


def outcome_of(
    reader: Reader,
    seed: int,
    number: int,
    folder: Path,
    before_full: Callable[[], None] = lambda: None,
) -> Outcome:
    """Read an input, and use it if it is accepted; its files stay in the folder.

    `before_full` is called before it is used in full.
    """
    kind = "accepted"

    def run() -> None:
        nonlocal kind
        value = reader.read(folder)
        reader.use(value)
        if rng.random() < reader.full_share:
            kind = "full"
            before_full()
            reader.use_in_full(value)

    try:
        rng = write_input(reader, seed, number, folder)
        message = checked(run)
    except Exception as error:
        text = f"{type(error).__name__}: {str(error)[:300]}"
        return Outcome("failed", text, traceback.format_exc(limit=-12)[-4000:])
    if message is None:
        return Outcome(kind)
    if "not enough memory" in message:
        return Outcome("failed", f"takes too much memory: {message}")
    return Outcome("refused", message)
