"""Runs a script in Blender: a program, or a Python that has the module `bpy`."""

import glob
import os
import re
import shutil
import subprocess
import sys
from collections.abc import Sequence
from pathlib import Path

from lumitree.errors import LumitreeError, shown

_LIMIT = 600
# Where Blender is installed, on macOS and on Windows.
_PLACES = (
    "/Applications/Blender.app/Contents/MacOS/Blender",
    r"%ProgramFiles%\Blender Foundation\*\blender.exe",
)
# Runs a script by Python without its folder on the path of imports; ends with 3 without bpy.
_PYTHON = """
import runpy, sys
try:
    import bpy
except ImportError:
    sys.exit(3)
sys.argv = sys.argv[1:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def find_blender(program: str | os.PathLike[str] | None) -> str:
    """Path of the program that runs scripts: Blender, or a Python with `bpy`.

    Without a name, `blender` on the search path, one that an installer put elsewhere, or this
    Python if it has `bpy`.

    Raises:
        LumitreeError: there is none.
    """
    if program is not None:
        # An application of macOS is a folder.
        inside = os.path.join(program, "Contents", "MacOS", "Blender")
        found = shutil.which(inside) or shutil.which(program)
        if found is None:
            raise LumitreeError(
                f"{shown(program, 200)} is not a program; expected Blender, or a Python with bpy"
            )
        return found
    found = shutil.which("blender") or _installed()
    if found is not None:
        return found
    import importlib.util

    if importlib.util.find_spec("bpy") is not None:
        return sys.executable
    raise LumitreeError(
        "no Blender was found to write the file; name it with --blender, put it on PATH, or "
        "write a .py file, which runs in any Blender"
    )


def _installed() -> str | None:
    """The Blender that an installer put where it does, and not on the search path."""
    found = [name for pattern in _PLACES for name in glob.glob(os.path.expandvars(pattern))]
    return max(found, key=_numbers, default=None)


def _numbers(name: str) -> list[int]:
    """Numbers in a path, by which the newest Blender is found: 4.10 is newer than 4.2."""
    return [int(each) for each in re.findall(r"\d+", name)]


def run_script(
    program: str,
    script: Path,
    arguments: Sequence[str],
    output: Path,
    limit: float = _LIMIT,
) -> None:
    """Run a script that writes `output`, for at most `limit` seconds.

    Raises:
        LumitreeError: it failed, with the last line that it printed; or it wrote nothing.
    """
    if Path(program).name.lower().startswith("python"):
        command = [program, "-P", "-c", _PYTHON, str(script), *arguments]
    else:
        options = ["--background", "--factory-startup", "--python-exit-code", "1"]
        command = [program, *options, "--python", str(script), "--", *arguments]
    try:
        run = subprocess.run(
            command, capture_output=True, text=True, errors="replace", timeout=limit
        )
    except subprocess.TimeoutExpired:
        raise LumitreeError(f"{shown(program, 200)} took more than {limit:g} s") from None
    if run.returncode == 3:
        raise LumitreeError(f"{shown(program, 200)} has no module bpy; pip install bpy, or Blender")
    if run.returncode:
        lines = (run.stderr.strip() or run.stdout.strip() or "no message").splitlines()
        raise LumitreeError(
            f"{shown(program, 200)} ended with status {run.returncode}: {shown(lines[-1], 300)}"
        )
    if not output.exists():
        raise LumitreeError(
            f"{shown(program, 200)} ended without an error, and wrote nothing; expected Blender, "
            "or a Python with bpy"
        )
