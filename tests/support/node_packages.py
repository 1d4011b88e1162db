"""Packages of npm that slow tests run."""

import os
import shutil
import subprocess
from pathlib import Path

import pytest

# The official validator of glTF, and a renderer that loads it.
_PACKAGES = ("gltf-validator@2.0.0-dev.3.10", "three@0.187.0")
_SECONDS = 120


def node_modules(folder: Path) -> Path:
    """The folder of the packages, which LUMITREE_NODE_MODULES names, or which npm makes.

    The test is skipped if npm is missing or cannot install them.

    Args:
        folder: an empty one, into which npm installs them.
    """
    given = os.environ.get("LUMITREE_NODE_MODULES")
    if given:
        return Path(given)
    npm = shutil.which("npm")
    if npm is None or shutil.which("node") is None:
        pytest.skip("no program npm")
    command = [npm, "install", "--no-audit", "--no-fund", "--prefix", str(folder), *_PACKAGES]
    try:
        subprocess.run(command, check=True, capture_output=True, timeout=_SECONDS)
    except (subprocess.SubprocessError, OSError) as error:
        pytest.skip(f"npm does not install {', '.join(_PACKAGES)}: {error}")
    return folder / "node_modules"


def run_node(modules: Path, script: str, *arguments: str) -> str:
    """Output of a script of Node, which may require packages of a folder."""
    environment = {**os.environ, "NODE_PATH": str(modules)}
    run = subprocess.run(
        ["node", "-e", script, *arguments], capture_output=True, text=True, env=environment
    )
    assert run.returncode == 0, run.stderr
    return run.stdout
