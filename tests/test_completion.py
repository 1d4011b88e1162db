"""Completion by the shell: what is offered, and that nothing heavy is imported for it."""

import subprocess
import sys

import pytest

from lumitree.cli.signatures import BUILTIN_NAMES
from lumitree.lamp.builtin import BUILTIN

CODE = """
import sys
from lumitree.cli import main
sys.argv[0] = "lumitree"
main(["__complete", *sys.argv[1:]])
assert not {"mitsuba", "drjit", "jax", "numpy", "matplotlib"} & set(sys.modules)
"""


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    for name in ["a.lumitree", "b.xml", "c.glb", "d.ies", "e.toml", "f.png", "g.txt"]:
        (tmp_path / name).touch()
    (tmp_path / "sub").mkdir()


def test_builtin_names_are_those_of_the_registry():
    assert set(BUILTIN_NAMES) == set(BUILTIN)


@pytest.mark.parametrize(
    ("words", "names"),
    [
        (["capture", "b"], {"b.xml", "bulbs"}),
        (["bake", "bulbs", ""], {*BUILTIN_NAMES, "a.lumitree", "b.xml", "c.glb", "d.ies", "sub/"}),
        (["evaluate", "a.lumitree", "c"], {"c.glb", "cluster"}),
        (["render", "b.xml", "--place", "a"], {"a.lumitree", "arc"}),
    ],
)
def test_lamps_are_offered(words, names):
    result = subprocess.run(
        [sys.executable, "-c", CODE, *words], capture_output=True, text=True, check=True
    )
    # Lines with the character 1F are directives.
    found = {line.split("\t")[0] for line in result.stdout.splitlines() if "\x1f" not in line}
    assert found - {""} == names


@pytest.mark.parametrize("shell", ["bash", "zsh", "fish"])
def test_scripts_of_shells_have_commands_options_and_choices(shell):
    """cyclopts writes them; `lumitree --install-completion` installs one."""
    from lumitree.cli.app import program

    script = program().generate_completion(shell=shell)
    for word in ("illuminance", "quality", "preview", "standard", "paper", "place"):
        assert word in script
