"""A lamp of an IES file is baked again when the file of its TILT table has changed."""

import pytest

import lumitree
from support.baked_folders import bake_nothing, make_old
from support.ies_text import ies_text
from support.tiny_bakes import standard

TABLE = "1\n3\n0 45 90\n0.9 1 1\n"


@pytest.fixture(autouse=True)
def folder(tmp_path, monkeypatch, mi):
    monkeypatch.chdir(tmp_path)
    text = ies_text([[1000, 500, 0]], [0], [0, 45, 90])
    (tmp_path / "a.ies").write_text(text.replace("TILT=NONE", "TILT=table.tlt"))
    (tmp_path / "table.tlt").write_text(TABLE)
    make_old(tmp_path / "a.ies", tmp_path / "table.tlt")
    bake_nothing(monkeypatch)
    return tmp_path


def state():
    return [lamp.state for lamp in lumitree.bake_many(["a.ies"], "out", standard()).lamps]


@pytest.mark.parametrize("old", [True, False])
def test_a_changed_table_is_another_lamp(folder, old):
    """Whether it is known from the record of the files, or from what they hold."""
    assert state() == ["baked"]
    assert state() == ["kept"]
    (folder / "table.tlt").write_text(TABLE.replace("0.9", "0.85"))
    if old:
        make_old(folder / "table.tlt")
    assert state() == ["baked"]
    assert state() == ["kept"]


def test_a_table_that_is_gone_is_a_failure(folder):
    state()
    (folder / "table.tlt").unlink()
    assert state() == ["failed"]
