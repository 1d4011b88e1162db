"""The program `lumitree`: where it is, and how it is run."""

import shutil
import subprocess
import time
from collections.abc import Sequence
from pathlib import Path

_PREFERENCES = "in the preferences of the extension Lumitree"
_ERROR = "lumitree: error: "
# Seconds in which a program that is told to end does so, and between looks at one that is awaited.
_END_SECONDS, _LOOK_SECONDS = 10.0, 0.1


class ExtensionError(Exception):
    """The fault, and its remedy, in one line."""


def find_program(setting: str) -> list[str]:
    """The first arguments of a command.

    Args:
        setting: path or name of the program lumitree, or of a Python that has it. Empty:
            `lumitree` on the search path.

    Raises:
        ExtensionError: there is no such program.
    """
    found = shutil.which(setting or "lumitree")
    if found is None and setting:
        raise ExtensionError(f"{setting} is not a program; correct its path {_PREFERENCES}")
    if found is None:
        raise ExtensionError(f"lumitree was not found; install it, and name it {_PREFERENCES}")
    is_python = Path(found).name.lower().startswith("python")
    return [found, "-m", "lumitree"] if is_python else [found]


def export_command(
    program: Sequence[str], asset: Path, script: Path, lights: int, up: str
) -> list[str]:
    """Command that writes the script of an asset.

    Args:
        program: from `find_program`.
        lights: largest number of point lights.
        up: axis that points up in the lamp's file, "y" or "z".
    """
    options = ["--lights", str(lights), "--up", up]
    return [*program, "export", str(asset), "-o", str(script), *options]


def bake_command(program: Sequence[str], model: Path, asset: Path, quality: str) -> list[str]:
    """Command that bakes a model into an asset."""
    return [*program, "bake", str(model), "-o", str(asset), "--quality", quality]


class Job:
    """Commands that run one after the other, beside Blender.

    Args:
        commands: arguments of each; the first starts at once.
        log: file that gets what they print as progress and errors.
    """

    def __init__(self, commands: Sequence[Sequence[str]], log: Path) -> None:
        self._commands, self._log = list(commands), log
        self._began = time.monotonic()
        self._process = self._start()

    def poll(self) -> bool:
        """Whether all commands have ended; starts the next one.

        Raises:
            ExtensionError: a command failed; with the last line that it printed.
        """
        status = self._process.poll()
        if status is None:
            return False
        if status:
            line = self._last_line().removeprefix(_ERROR)
            raise ExtensionError(line or f"lumitree ended with status {status}")
        if not self._commands:
            return True
        self._process = self._start()
        return False

    def wait(self) -> None:
        """Wait until all commands have ended. Raises the errors of `poll`."""
        while not self.poll():
            time.sleep(_LOOK_SECONDS)

    def stop(self) -> None:
        """End the command that runs; the others do not start."""
        self._commands = []
        if self._process.poll() is None:
            self._process.terminate()
            try:
                self._process.wait(_END_SECONDS)
            except subprocess.TimeoutExpired:
                self._process.kill()
                self._process.wait()

    def progress(self) -> str:
        """One line: the latest that the command printed, and the seconds so far."""
        seconds = time.monotonic() - self._began
        return f"{self._last_line() or 'lumitree'} ({seconds:.0f} s; Esc cancels)"

    def _start(self) -> "subprocess.Popen[bytes]":
        command = self._commands.pop(0)
        # No window with a console on Windows.
        flags = getattr(subprocess, "CREATE_NO_WINDOW", 0)
        try:
            with self._log.open("wb") as log:
                return subprocess.Popen(
                    command,
                    stdin=subprocess.DEVNULL,
                    stdout=subprocess.DEVNULL,
                    stderr=log,
                    creationflags=flags,
                )
        except OSError as error:
            raise ExtensionError(f"{command[0]} does not start: {error.strerror}") from error

    def _last_line(self) -> str:
        text = self._log.read_text(encoding="utf-8", errors="replace")
        return next((line.strip() for line in reversed(text.splitlines()) if line.strip()), "")
