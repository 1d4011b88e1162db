"""What lumitree needs of its surroundings: here, no more than the C locale."""

import os
import subprocess
import sys

import pytest

import lumitree
from support.exported_lamps import lamp


def run(arguments, folder, **changes):
    """A command in a process of its own; `changes` of its environment: None removes a variable."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **changes}
    return subprocess.run(
        [sys.executable, "-m", "lumitree", *arguments],
        cwd=folder,
        env={name: value for name, value in environment.items() if value is not None},
        capture_output=True,
        timeout=300,
    )


C_LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": None}


@pytest.mark.skipif(os.name == "nt", reason="it has no C locale")
@pytest.mark.parametrize("arguments", [["render", "--help"], ["info", "lamp.lumitree"]])
def test_output_in_the_c_locale(tmp_path, arguments):
    """Characters that ASCII lacks become question marks."""
    lumitree.save(lamp("Größe ±"), tmp_path / "lamp.lumitree")
    result = run(arguments, tmp_path, **C_LOCALE)
    assert result.returncode == 0, result.stderr.decode()
    assert result.stdout.isascii()
    assert result.stderr == b""
