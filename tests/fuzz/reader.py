"""What a reader is, and what has to hold for each input."""

import contextlib
import dataclasses
import zlib
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from support.damage import checked

MEBIBYTE = 1 << 20


def nothing(_: Any) -> None:
    """For readers whose values need no check."""


@dataclasses.dataclass(frozen=True)
class Reader:
    """A reader of files.

    Attributes:
        name: for the command.
        make: takes a random generator, and returns the content of the files of an input by name.
        read: takes the folder of the files; returns what was read.
        use: takes what was read, and fails if it is not sound.
        use_in_full: the same, by a rendering or a bake: it takes long.
        memory: bytes that one input may take at most, besides what the program has.
        in_suite: inputs of the default tests.
        full_share: part of the accepted inputs of long runs that are used in full.
    """

    name: str
    make: Callable[[np.random.Generator], dict[str, bytes]]
    read: Callable[[Path], Any]
    use: Callable[[Any], None] = nothing
    use_in_full: Callable[[Any], None] = nothing
    memory: int = 1024 * MEBIBYTE
    in_suite: int = 40
    full_share: float = 1 / 1000

    def outcome(self, seed: int, number: int, folder: Path, full_share: float = 0.0) -> str:
        """Read an input, and use it if it is accepted; its files stay in the folder.

        Returns:
            "accepted", "full" (accepted, and used in full) or "refused".
        """
        rng = generator(self.name, seed, number)
        for name, content in self.make(rng).items():
            path = folder / name
            path.parent.mkdir(parents=True, exist_ok=True)
            path.write_bytes(content)
        in_full = rng.random() < full_share

        def run() -> None:
            with at_most(self.memory):
                value = self.read(folder)
                self.use(value)
            if in_full:
                self.use_in_full(value)

        try:
            message = checked(run)
        except Exception as error:
            error.add_note(f"input {number} of reader {self.name} with seed {seed}, in {folder}")
            raise
        assert "not enough memory" not in (message or ""), f"input {number}: {message}"
        if message is not None:
            return "refused"
        return "full" if in_full else "accepted"


def generator(name: str, seed: int, number: int) -> np.random.Generator:
    """The random numbers of an input."""
    return np.random.default_rng([zlib.crc32(name.encode()), seed, number])


@contextlib.contextmanager
def at_most(memory: int):
    """Limit the address space to its present size and so many bytes more, on Linux."""
    try:
        import resource

        pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[0])
    except (ImportError, OSError):
        yield
        return
    before = resource.getrlimit(resource.RLIMIT_AS)
    limit = pages * resource.getpagesize() + memory
    resource.setrlimit(resource.RLIMIT_AS, (limit, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_AS, before)
