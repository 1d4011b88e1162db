"""The extension for Blender, as lumitree ships it."""

import zipfile

import pytest

import lumitree
from lumitree.cli import main
from lumitree.errors import LumitreeError


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
