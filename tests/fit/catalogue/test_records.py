"""Records of lamps: what they keep, and which lamps are kept without loading them."""

import dataclasses
import json
import os

import pytest

from lumitree.errors import LumitreeError
from lumitree.fit.catalogue import stamps
from lumitree.fit.catalogue.folder import (
    Part,
    Records,
    check_folder,
    mark_folder,
    read_parts,
    write_part,
)
from lumitree.fit.catalogue.record import LampFiles
from lumitree.fit.config import BakeConfig
from support.baked_folders import record_of, write_lamp, write_old, written_job


@pytest.fixture
def job(tmp_path):
    (tmp_path / "lamps").mkdir()
    return written_job(tmp_path / "lamps", tmp_path / "out", "a.b")


def test_records_survive_a_file(tmp_path):
    files = write_lamp(tmp_path, "a.b")
    record = record_of(files, options='["x.xml", null, [], []]')
    for each in (
        record,
        dataclasses.replace(record, finished=False, image="png"),
        dataclasses.replace(record, files=(record.asset,)),
        dataclasses.replace(record, figures=record.figures | {"irradiance_rms": None}),
    ):
        files.write(each)
        assert files.read() == each


def test_a_record_of_the_first_version_is_read(tmp_path):
    """Its thumbnail is a PNG file, and its asset is compared by content."""
    files = write_lamp(tmp_path, "a")
    path = tmp_path / "index-files" / "a.json"
    record = files.read()
    first = {
        "version": 1,
        "state": "finished",
        "fingerprint": "0" * 64,
        "settings": "{}",
        "asset_sha256": record.asset.digest,
        "seconds": 2.5,
        "figures": {"lumens": 1.0, "file_bytes": 1, "size": [1, 1, 1]},
    }
    path.write_text(json.dumps(first))
    found = files.read()
    assert (found.files, found.image, found.fingerprint) == (None, "png", "0" * 64)
    assert found.of_asset(tmp_path).asset == record.asset
    write_old(files.asset, b"b")
    assert found.of_asset(tmp_path) is None
    assert list(Records(tmp_path).lamps()) == ["a"]


@pytest.mark.parametrize(
    "change",
    [
        {"version": 3},
        {"asset": [1]},
        {"asset": ["x", 0, ""]},
        {"files": [["a", 1]]},
        {"image": "html"},
        {"figures": {}},
        {"settings": 3},
    ],
)
def test_damaged_records_are_none(tmp_path, change):
    files = write_lamp(tmp_path, "a")
    path = tmp_path / "index-files" / "a.json"
    path.write_text(json.dumps(json.loads(path.read_text()) | change))
    assert files.read() is None
    assert Records(tmp_path).lamps() == {}


def test_a_lamp_is_kept_by_size_and_time_alone(job, monkeypatch):
    monkeypatch.setattr(stamps, "file_digest", lambda _: pytest.fail("a file was read"))
    kept = job.kept()
    assert (kept.name, kept.state, kept.seconds) == ("a.b", "kept", 12.0)
    assert kept.path == job.folder / "a.b.lumitree"


def test_a_lamp_is_not_kept_if_anything_differs(job, tmp_path):
    for change in (
        {"settings": "{}"},
        {"source": dataclasses.replace(job.source, keep=("a",))},
        {"source": dataclasses.replace(job.source, materials="a.toml")},
        {"folder": tmp_path / "other"},
    ):
        assert dataclasses.replace(job, **change).kept() is None
    files = LampFiles(job.folder, job.name)
    record = files.read()
    for change in ({"finished": False}, {"files": None}):
        files.write(dataclasses.replace(record, **change))
        assert job.kept() is None
    files.write(record)
    assert job.kept() is not None
    # Overrides that were added, another source, another asset.
    for path in (tmp_path / "lamps" / "a.b.toml", tmp_path / "lamps" / "a.b.xml", files.asset):
        before = path.read_bytes() if path.exists() else None
        write_old(path, b"<scene>other</scene>")
        assert job.kept() is None
        path.unlink()
        if before is not None:
            write_old(path, before)
        assert job.kept() is not None


def test_files_with_new_times_are_read_once(job, tmp_path, monkeypatch):
    path = tmp_path / "lamps" / "a.b.xml"
    os.utime(path, (2_000_000, 2_000_000))
    assert job.kept() is not None
    monkeypatch.setattr(stamps, "file_digest", lambda _: pytest.fail("a file was read"))
    assert job.kept() is not None


def test_a_folder_that_was_moved_with_its_lamps_is_kept(job, tmp_path):
    (tmp_path / "moved").mkdir()
    for name in ("lamps", "out"):
        (tmp_path / name).rename(tmp_path / "moved" / name)
    source = dataclasses.replace(job.source, name=str(tmp_path / "moved" / "lamps" / "a.b.xml"))
    moved = dataclasses.replace(job, folder=tmp_path / "moved" / "out", source=source)
    assert moved.kept() is not None


def test_a_failure_is_forgotten_when_the_lamp_is_kept(job):
    files = LampFiles(job.folder, job.name)
    files.write_failure("no light")
    found = Records(job.folder).lamps()["a.b"].lamp
    assert (found.state, found.error, found.path) == ("failed", "no light", None)
    assert job.kept() is not None
    assert Records(job.folder).lamps()["a.b"].lamp.state == "kept"


def test_records_are_read_again_only_when_they_change(tmp_path, monkeypatch):
    for name in ("a", "b", "c"):
        write_lamp(tmp_path, name)
    records, read = Records(tmp_path), LampFiles.read
    names = []

    def noted(files):
        names.append(files.name)
        return read(files)

    monkeypatch.setattr(LampFiles, "read", noted)
    assert sorted(records.lamps()) == ["a", "b", "c"]
    names.clear()
    write_lamp(tmp_path, "b", finished=False)
    assert records.lamps()["b"].lamp.state == "interrupted"
    assert names == ["b"]
    (tmp_path / "a.lumitree").unlink()
    (tmp_path / "index-files" / "c.webp").unlink()
    lamps = records.lamps()
    assert sorted(lamps) == ["b", "c"]
    assert (lamps["b"].image, lamps["c"].image) == ("b.webp", None)


def test_a_later_version_is_refused(tmp_path):
    check_folder(tmp_path)
    mark_folder(tmp_path)
    check_folder(tmp_path)
    path = tmp_path / "index-files" / "folder" / "version.json"
    path.write_text('{"version": 3}')
    mark_folder(tmp_path)
    with pytest.raises(LumitreeError, match="has records of version 3, this lumitree reads 1 to 2"):
        check_folder(tmp_path)
    path.write_text("{")
    with pytest.raises(
        LumitreeError, match=r"version.json is damaged \(not valid JSON.*; remove it"
    ):
        check_folder(tmp_path)


@pytest.mark.parametrize(("number", "count"), [(0, 1), (2, 1), (1, 0), (1, 10**6)])
def test_parts_that_are_none_are_refused(number, count):
    with pytest.raises(LumitreeError, match=r"part is|number of parts is"):
        Part(number, count)


def test_parts_state_what_is_missing(tmp_path):
    assert read_parts(tmp_path) == ([], [], 0)
    write_part(tmp_path, Part(1, 3), ["old"])
    folder = tmp_path / "index-files" / "folder"
    os.utime(folder / "part-1-of-3.json", (0, 0))
    write_part(tmp_path, Part(2, 4), ["b", "f"])
    write_part(tmp_path, Part(3, 4), ["c"])
    names, missing, count = read_parts(tmp_path)
    assert (sorted(names), missing, count) == (["b", "c", "f"], [1, 4], 4)
    (folder / "part-2-of-4.json").write_text("{")
    assert read_parts(tmp_path) == (["c"], [1, 4], 4)


def test_settings_of_other_qualities_are_other_text(tmp_path):
    (tmp_path / "lamps").mkdir()
    one = written_job(tmp_path / "lamps", tmp_path / "out", "a", BakeConfig.of("preview"))
    two = written_job(tmp_path / "lamps", tmp_path / "out", "b", BakeConfig.of("high"))
    assert one.settings != two.settings
