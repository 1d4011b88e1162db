"""Stop signals of the program `lumitree` while its command has not begun, and once it has ended.

In between `core.interrupt` handles them. This is imported before anything that takes time.
"""

import io
import os
import signal
import sys
from typing import Any

from lumitree.core.system import STOP_SIGNALS


def is_program() -> bool:
    """Whether the process is the command line, and not a program that imports lumitree."""
    name = os.path.basename(sys.argv[0]) if getattr(sys, "argv", None) else ""
    # While Python locates the module of `python -m`, the name is -m. Windows has programs .exe.
    module = " ".join(sys.orig_argv).partition(" -m ")[2].split()[:1]
    return name in ("lumitree", "lumitree.exe") or (name == "-m" and module == ["lumitree"])


def exit_on_signals() -> None:
    """Let every stop signal that is not ignored end the process at once, with one line."""

    def end(number: int, _: object) -> None:
        line = b"lumitree: error: interrupted before the command began\n"
        try:
            os.write(2, line)
        finally:
            os._exit(128 + number)

    for number in STOP_SIGNALS:
        if signal.getsignal(number) is not signal.SIG_IGN:
            signal.signal(number, end)


class _Messages(io.FileIO):
    """Standard error: what cannot be written there, as to a pipe that is closed, is dropped."""

    def write(self, data: Any) -> int:
        try:
            return super().write(data)
        except OSError:
            return len(data)


def open_streams() -> None:
    """Open the null device in place of standard streams that the parent process has closed.

    Else files would get their descriptors, and messages would be written into these files. Nor does
    a standard error that nobody reads any more end the work.
    """
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            # The lowest number that is free, for this process and its children.
            descriptor = os.open(os.devnull, os.O_RDWR)
            os.set_inheritable(descriptor, True)
            setattr(sys, name, os.fdopen(descriptor, mode, closefd=False))
    if not sys.stderr.isatty():
        raw = _Messages(sys.stderr.fileno(), "w", closefd=False)
        sys.stderr = io.TextIOWrapper(
            io.BufferedWriter(raw), sys.stderr.encoding, sys.stderr.errors, write_through=True
        )


def ignore_signals() -> None:
    """Ignore stop signals from now on: the exit status is known."""
    for number in STOP_SIGNALS:
        signal.signal(number, signal.SIG_IGN)
