"""The way of `l_max` that CONTRIBUTING.md describes exists in the code."""

import argparse
import ast
import inspect
import re
from pathlib import Path

import pytest

import lumitree
from lumitree.cli import bake
from lumitree.fit.octree.config import DirectConfig

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
    assert packages[:3] == ["cli", "cli", "fit"]
    assert {"fit", "asset", "octree", "core"} == set(packages[3:])


@pytest.mark.parametrize(("file", "symbol"), STEPS)
def test_each_step_names_the_parameter(file, symbol):
    assert re.search(r"\bl_max\b", source_of(file, symbol))


@pytest.mark.parametrize("function", [lumitree.bake, DirectConfig, DirectConfig.with_options])
def test_the_parameter_is_in_each_signature(function):
    parameters = inspect.signature(function).parameters
    assert "l_max" in parameters
    assert all(each.kind is not each.VAR_KEYWORD for each in parameters.values())


def test_the_command_line_passes_it_on(monkeypatch):
    passed = {}

    def record(luminaire, output, **options):
        passed.update(options)
        raise lumitree.LumitreeError("recorded")

    monkeypatch.setattr(lumitree, "bake", record, raising=False)
    parser = argparse.ArgumentParser()
    bake.add(parser.add_subparsers())
    args = parser.parse_args(["bake", "bulbs", "-o", "a.lumitree", "--l-max", "3"])
    with pytest.raises(lumitree.LumitreeError, match="recorded"):
        args.run(args)
    assert passed["l_max"] == 3
