"""lumitree without the packages of the network, which are hidden here."""

import subprocess
import sys
from pathlib import Path

import pytest

import lumitree
from lumitree.core import backend
from support.lamps import BALL, room

TESTS = Path(__file__).parents[1]
LINE = (
    "the network needs packages that are not installed (jax, flax, optax); "
    "install them with `pip install 'lumitree[network]'`"
)
HIDE = """
import sys

class Hider:
    def find_spec(self, name, path=None, target=None):
        if name.partition(".")[0] in ("jax", "jaxlib", "flax", "optax"):
            raise ModuleNotFoundError(f"No module named {name!r}", name=name)

sys.meta_path.insert(0, Hider())
"""
# Scripts that Blender runs import its own module.
IMPORT_ALL = """
import importlib, pkgutil
import lumitree, lumitree.cli
from lumitree.core.backend import load_mitsuba

load_mitsuba("llvm_ad_rgb")
for module in pkgutil.walk_packages(lumitree.__path__, "lumitree."):
    name = module.name
    apart = name.startswith("lumitree.fit.network.")
    if not apart and not name.endswith(("__main__", "_script")):
        importlib.import_module(name)
import lumitree.fit.network.config
for name in lumitree.__all__:
    getattr(lumitree, name)
print(sorted({"jax", "jaxlib", "flax", "optax"} & set(sys.modules)))
"""


def run(code, *arguments, folder=None):
    command = [sys.executable, "-c", code, *arguments]
    return subprocess.run(command, cwd=folder, capture_output=True, text=True)


def command(folder, *arguments):
    """A command of `tiny_bakes`, without the packages."""
    script = f"sys.path.insert(0, {str(TESTS)!r})\nimport runpy\n"
    script += "runpy.run_module('support.tiny_bakes', run_name='__main__')"
    return run(HIDE + script, *arguments, folder=folder)


def test_nothing_but_the_network_imports_jax():
    result = run(HIDE + IMPORT_ALL)
    assert (result.stdout.strip(), result.returncode) == ("[]", 0), result.stderr


@pytest.mark.slow
def test_lamps_are_baked_and_rendered_without_the_network(tmp_path):
    (tmp_path / "lamp.xml").write_text(BALL)
    (tmp_path / "room.xml").write_text(room(8, 8))
    for line in (
        ["bake", "--help"],
        ["bake", "lamp.xml", "-o", "a.lumitree"],
        ["info", "a.lumitree"],
        ["capture", "lamp.xml", "-o", "views", "--views", "1", "--resolution", "8", "--spp", "1"],
        ["render", "room.xml", "-o", "a.png", "--place", "a.lumitree", "--at", "0,3,0", "--size",
         "1", "--spp", "1"],
    ):  # fmt: skip
        result = command(tmp_path, *line)
        assert result.returncode == 0, result.stderr
    assert (tmp_path / "a.png").exists()


@pytest.mark.parametrize(
    "line",
    [
        ["bake", "lamp.xml", "-o", "a.lumitree", "--method", "network"],
        ["extract", "run", "-o", "a.lumitree"],
    ],
    ids=" ".join,
)
def test_commands_of_the_network_say_what_to_install(tmp_path, line):
    """Before they read or write a file."""
    result = command(tmp_path, *line)
    assert result.returncode == 2
    assert result.stderr == f"lumitree: error: {LINE}\n"
    assert not list(tmp_path.iterdir())


def test_only_what_is_missing_is_named(monkeypatch):
    modules = {"json": "a", "no_such_module": "b", "no_such.module": "c", "json.decoder": "d"}
    monkeypatch.setattr(backend, "NETWORK", modules)
    with pytest.raises(lumitree.LumitreeError, match=r"not installed \(b, c\); install"):
        backend.check_network()
    monkeypatch.setattr(backend, "NETWORK", {"json": "a"})
    backend.check_network()
