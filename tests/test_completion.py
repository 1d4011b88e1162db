"""Completion by the shell: what is offered, and that nothing heavy is imported for it."""

import os
import subprocess
import sys

import pytest

from lumitree.cli.completion import BUILTIN_NAMES
from lumitree.lamp.builtin import BUILTIN

HEAVY = ("mitsuba", "drjit", "jax", "numpy", "matplotlib", "rich")
# `os._exit` ends a completion; it is replaced before argcomplete binds it.
CODE = f"""
import os, sys
exit_now = os._exit
def leave(status):
    print(sorted(set({HEAVY!r}) & set(sys.modules)), flush=True)
    exit_now(status)
os._exit = leave
from lumitree.cli import main
main([])
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    names = "a.lumitree b.xml c.glb d.ies e.toml f.png g.txt"
    for name in names.split():
        (tmp_path / name).touch()
    (tmp_path / "sub").mkdir()


def offered(line):
    """Completions of a command line whose cursor is at its end."""
    environment = os.environ | {
        "_ARGCOMPLETE": "1",
        "_ARGCOMPLETE_IFS": "\n",
        "_ARGCOMPLETE_STDOUT_FILENAME": "found",
        "COMP_LINE": line,
        "COMP_POINT": str(len(line)),
    }
    result = subprocess.run(
        [sys.executable, "-c", CODE], env=environment, capture_output=True, text=True
    )
    assert result.stdout == "[]\n", result
    with open("found") as file:
        return {name.strip() for name in file.read().split("\n")}


def test_builtin_names_are_those_of_the_registry():
    assert set(BUILTIN_NAMES) == set(BUILTIN)


@pytest.mark.parametrize(
    ("line", "names"),
    [
        ("lumitree pre", {"preview"}),
        ("lumitree bake --qual", {"--quality"}),
        ("lumitree bake --quality ", {"preview", "standard", "high", "paper"}),
        ("lumitree info ", {"a.lumitree", "d.ies", "sub/", "-h", "--help", "--json"}),
        ("lumitree capture b", {"b.xml", "bulbs"}),
        ("lumitree bake bulbs ", {*BUILTIN_NAMES, "b.xml", "c.glb", "d.ies", "sub/"}),
        ("lumitree evaluate a.lumitree c", {"c.glb", "cluster"}),
        ("lumitree render b.xml --placements ", {"e.toml", "sub/"}),
        (
            "lumitree render b.xml --place ",
            {*BUILTIN_NAMES, "a.lumitree", "b.xml", "c.glb", "d.ies", "sub/"},
        ),
        ("lumitree train s", {"sub/"}),
    ],
)
def test_offers(line, names):
    found = offered(line)
    # Options are offered too where an argument may follow.
    assert names <= found
    assert {name for name in found if not name.startswith("-")} == {
        name for name in names if not name.startswith("-")
    }
