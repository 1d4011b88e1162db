"""What all targets of `lumitree export` have in common."""

import os
import re
from importlib.util import find_spec

import pytest

import lumitree
from lumitree.cli import main
from lumitree.errors import LumitreeError
from lumitree.exports.export import TARGETS, find_target
from lumitree.exports.target import ExportRequest
from support.exported_lamps import lamp
from support.fields import random_asset

needs_usd = pytest.mark.skipif(
    find_spec("pxr") is None, reason="the optional dependency usd is not installed"
)
# Those that no other program writes.
OUTPUTS = (
    *("lamp.py", "lamp.rad", "lamp.pbrt", "lamp.glb", "lamp/"),
    *(pytest.param(name, marks=needs_usd) for name in ("lamp.usda", "lamp.usdz")),
)


def test_the_suffix_or_a_slash_chooses_the_target():
    for output, suffix in (
        ("a/lamp.rad", ".rad"), ("lamp", ""), ("lamp.rad/", ""), ("lamp.v2.pbrt", ".pbrt"),
        ("lamp.RAD", ".rad"),
    ):  # fmt: skip
        assert find_target(output) is TARGETS[suffix]
    for output in ("lamp.ies", "a.b/lamp.txt"):
        with pytest.raises(LumitreeError, match=r"does not end in \.py, .* and is not a folder"):
            find_target(output)


@pytest.mark.parametrize("output", OUTPUTS)
def test_every_target_says_what_it_wrote(mi, tmp_path, output):
    result = lumitree.export(lamp(), f"{tmp_path}/out/{output}", lights=3)
    assert result.lights == 3
    assert result.target == find_target(output).name
    assert result.units.startswith("metres; ")
    assert " is up; the origin is the origin of the lamp's file" in result.orientation
    assert result.not_carried_over
    assert result.file == tmp_path / "out" / output
    written = [path for path in (tmp_path / "out").rglob("*") if path.is_file()]
    assert sorted(result.files) == sorted(written)
    assert result.file_bytes == sum(path.stat().st_size for path in written)
    assert all("\n" not in line for line in result.not_carried_over)


@pytest.mark.parametrize("output", OUTPUTS)
def test_equal_seeds_give_equal_files(mi, tmp_path, output):
    first, second = (
        lumitree.export(lamp(), f"{tmp_path}/{name}/{output}", lights=3, seed=4) for name in "ab"
    )
    assert [each.name for each in first.files] == [each.name for each in second.files]
    for one, other in zip(first.files, second.files, strict=True):
        # IES files hold the date.
        lines = [
            [line for line in each.read_bytes().splitlines() if b"[ISSUEDATE]" not in line]
            for each in (one, other)
        ]
        assert lines[0] == lines[1]


@pytest.mark.parametrize("output", OUTPUTS)
def test_every_target_explains_what_it_cannot_write(mi, tmp_path, monkeypatch, capsys, output):
    monkeypatch.chdir(tmp_path)
    lumitree.save(random_asset(0), "field.lumitree")
    lumitree.save(lamp(), "lamp.lumitree")
    for source, place, message in (
        ("field.lumitree", "", "no light field"),
        ("lamp.lumitree", "lamp.lumitree/", "cannot write"),
    ):
        assert main(["export", source, "-o", place + output]) == 2
        (line,) = capsys.readouterr().err.splitlines()
        assert message in line
    assert sorted(os.listdir(tmp_path)) == ["field.lumitree", "lamp.lumitree"]


def test_files_of_names_of_other_scripts_are_told_apart():
    names = ["灯笼.rad", "台灯.rad", "a b.rad", "a_b.rad", "plain-1.rad"]
    stems = [request(name).stem for name in names]
    assert len(set(stems)) == len(names)
    assert stems[3:] == ["a_b", "plain-1"]
    assert all(re.fullmatch(r"[A-Za-z0-9_.-]+", stem) for stem in stems)


def request(name):
    return ExportRequest(
        asset=None, lights=1, up="y", seed=0, blender=None, importer="any", name=name
    )
