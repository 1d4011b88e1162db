"""Rules for all targets of `lumitree export`, units of length, and the extension."""

import dataclasses
import os
import re
import zipfile
from importlib.util import find_spec

import numpy as np
import pytest

import lumitree
from lumitree.asset.geometry import Medium
from lumitree.cli import main
from lumitree.errors import LumitreeError
from lumitree.exports.export import TARGETS, find_target
from lumitree.exports.target import ExportRequest
from lumitree.rendering.asset_flux import asset_lumens
from support.exported_lamps import lamp
from support.fields import random_asset
from support.geometry_assets import small_geometry, with_geometry

pytestmark = pytest.mark.usefixtures("mi")


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


@pytest.fixture
def scattering_lamp():
    *others, sphere = small_geometry().shapes
    inside, outside = Medium((2.0, 20.0, 70.0)), Medium((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.5)
    sphere = dataclasses.replace(sphere, interior=inside, exterior=outside)
    return with_geometry(small_geometry(shapes=(*others, sphere)))


def test_a_factor_there_and_back_changes_nothing(scattering_lamp):
    large = scattering_lamp.scaled(100)
    assert large.frame.size == pytest.approx(100 * scattering_lamp.frame.size)
    assert asset_lumens(large) == pytest.approx(1e4 * asset_lumens(scattering_lamp))
    exterior = large.geometry.shapes[2].exterior
    assert exterior.scattering == pytest.approx([0.04, 0.05, 0.06])
    assert exterior.anisotropy == 0.5
    again = large.scaled(0.01)
    np.testing.assert_allclose(again.frame.world_from_local, scattering_lamp.frame.world_from_local)
    np.testing.assert_allclose(
        again.geometry.vertices, scattering_lamp.geometry.vertices, rtol=1e-6
    )
    assert again.geometry.shapes[2].interior.absorption == pytest.approx([2.0, 20, 70])


def test_other_units_are_refused(tmp_path):
    with pytest.raises(lumitree.LumitreeError, match="unit is 'yard'; expected m, cm"):
        lumitree.export(lamp(), tmp_path / "lamp.rad", unit="yard")


def test_the_command_writes_it_and_refuses_other_names(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["blender-extension", "-o", "x.zip"]) == 0
    assert capsys.readouterr().out.splitlines()[-1] == "Open: x.zip"
    assert zipfile.ZipFile("x.zip").testzip() is None
    assert main(["blender-extension", "-o", "x.tar"]) == 2
    assert "does not end in .zip" in capsys.readouterr().err


def test_the_result_has_its_size_and_version(tmp_path):
    result = lumitree.blender_extension(tmp_path / "x.zip")
    assert result.file_bytes == (tmp_path / "x.zip").stat().st_size
    assert result.version == lumitree.__version__
    with pytest.raises(LumitreeError, match=r"does not end in \.zip"):
        lumitree.blender_extension(tmp_path / "extension")
