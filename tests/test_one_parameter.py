"""The way of `l_max` that CONTRIBUTING.md describes exists in the code."""

import ast
import inspect
import re
from pathlib import Path

import pytest

import lumitree
from lumitree.cli import main
from lumitree.fit.config import BakeConfig
from lumitree.fit.octree.config import OctreeFitConfig

ROOT = Path(__file__).parent.parent
TEXT = (ROOT / "CONTRIBUTING.md").read_text(encoding="utf-8")
SECTION = TEXT.partition("## Follow one parameter\n")[2].partition("\n## ")[0]
STEPS = re.findall(r"^\| `([\w/.]+)` \| `([\w.]+)` \|", SECTION, re.MULTILINE)


def source_of(file, symbol):
    """Source of a function, class or method of a file."""
    text = (ROOT / file).read_text(encoding="utf-8")
    node = ast.parse(text)
    for name in symbol.split("."):
        node = next(each for each in node.body if getattr(each, "name", None) == name)
    return ast.get_source_segment(text, node)


def test_the_way_is_complete():
    packages = [Path(file).parts[2] for file, _ in STEPS]
    assert packages[0] == "fit"
    assert set(packages) == {"fit", "asset", "octree", "core"}


@pytest.mark.parametrize(("file", "symbol"), STEPS)
def test_each_step_names_the_parameter(file, symbol):
    assert re.search(r"\bl_max\b", source_of(file, symbol))


@pytest.mark.parametrize("function", [BakeConfig, OctreeFitConfig])
def test_the_parameter_is_in_each_signature(function):
    parameters = inspect.signature(function).parameters
    assert "l_max" in parameters
    assert all(each.kind is not each.VAR_KEYWORD for each in parameters.values())


def test_the_command_line_passes_it_on(monkeypatch, tmp_path):
    passed = []

    def record(source, output, config, **_):
        passed.append(config)
        raise lumitree.LumitreeError("recorded")

    monkeypatch.setattr("lumitree.fit.sources.bake_source", record)
    (tmp_path / "bake.toml").write_text("parts = ['field']\nl_max = 3")
    command = ["bake", "bulbs", "-o", "a.lumitree", "--config", str(tmp_path / "bake.toml")]
    assert main(command) == 2
    assert passed == [BakeConfig(parts=("field",), l_max=3)]
