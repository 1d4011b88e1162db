"""Whether a file has changed, by its size and time, and else by its content."""

import os
import time

import pytest

from lumitree.errors import LumitreeError
from lumitree.fit.catalogue import stamps
from lumitree.fit.catalogue.stamps import FileStamp, current_stamps, read_stamp, stamps_of

OLD = 1_000_000_000


@pytest.fixture
def file(tmp_path):
    path = tmp_path / "lamps" / "a.glb"
    path.parent.mkdir()
    path.write_bytes(b"lamp")
    os.utime(path, (OLD, OLD))
    return path


@pytest.fixture
def digests(monkeypatch):
    """Files whose content was read."""
    read, digest = [], stamps.file_digest

    def noted(path):
        read.append(path.name)
        return digest(path)

    monkeypatch.setattr(stamps, "file_digest", noted)
    return read


def test_equal_size_and_time_are_enough(file, tmp_path, digests):
    stamp = FileStamp.of(file, tmp_path / "out")
    assert stamp.name == "../lamps/a.glb"
    assert (stamp.size, stamp.modified) == (4, OLD * 10**9)
    digests.clear()
    assert stamp.current(tmp_path / "out") == stamp
    assert digests == []


def test_content_decides_if_the_time_is_another(file, tmp_path, digests):
    """As for files that were copied or checked out."""
    stamp = FileStamp.of(file, tmp_path)
    os.utime(file, (OLD + 10, OLD + 10))
    now = stamp.current(tmp_path)
    assert (now.digest, now.modified) == (stamp.digest, (OLD + 10) * 10**9)
    assert now.current(tmp_path) is now
    file.write_bytes(b"lamb")
    assert stamp.current(tmp_path) is None
    file.write_bytes(b"larger")
    digests.clear()
    assert stamp.current(tmp_path) is None
    assert digests == []


def test_a_file_that_is_just_written_is_compared_by_content(file, tmp_path, digests):
    """A second change within the same tick of the file system's clock has the same time."""
    file.write_bytes(b"new1")
    stamp = FileStamp.of(file, tmp_path)
    time_of_file = file.stat().st_mtime_ns
    file.write_bytes(b"new2")
    os.utime(file, ns=(time_of_file, time_of_file))
    assert stamp.current(tmp_path) is None


def test_missing_files_are_noticed_when_they_appear(tmp_path):
    path = tmp_path / "a.toml"
    stamp = FileStamp.of(path, tmp_path)
    assert stamp.current(tmp_path) is stamp
    path.write_text("")
    assert stamp.current(tmp_path) is None
    assert FileStamp.of(path, tmp_path).current(tmp_path) is not None
    path.unlink()
    assert read_stamp(FileStamp("a.toml", 0, 0, "0" * 64).to_json()).current(tmp_path) is None


def test_what_may_have_changed_since_it_was_read_has_no_stamp(file, tmp_path):
    now = time.time_ns()
    assert stamps_of([file], tmp_path, now) is not None
    file.write_bytes(b"lamp")
    assert stamps_of([file], tmp_path, now) is None
    assert stamps_of([tmp_path], tmp_path, now) is None


def test_files_on_another_disk_have_absolute_names(file, tmp_path, monkeypatch):
    """Windows has no relative path between its disks."""

    def relpath(*_):
        raise ValueError("path is on mount 'D:', start on mount 'C:'")

    expected = FileStamp.of(file, tmp_path)
    monkeypatch.setattr(stamps.os.path, "relpath", relpath)
    stamp = FileStamp.of(file, tmp_path / "other")
    assert stamp.name == file.absolute().as_posix()
    assert stamp.digest == expected.digest
    assert stamp.current(tmp_path / "other") == stamp


def test_pipes_are_not_opened(tmp_path):
    os.mkfifo(tmp_path / "pipe")
    assert FileStamp.of(tmp_path / "pipe", tmp_path) is None
    assert FileStamp("pipe", 0, 1, "").current(tmp_path) is None


def test_stamps_survive_a_file_and_damage_is_refused(file, tmp_path):
    stamp = FileStamp.of(file, tmp_path)
    assert read_stamp(stamp.to_json()) == stamp
    assert current_stamps([stamp, stamp], tmp_path) == (stamp, stamp)
    for value in (None, [], [1, 2, 3, 4], ["a", "4", 0, ""], ["a\n", 4, 0, ""], ["a", 4, 0.5, ""]):
        with pytest.raises(LumitreeError):
            read_stamp(value)
