"""Files appear whole or not at all."""

import contextlib
import errno
import json
import os
import resource
import socket
import subprocess
import sys
import tempfile
import tty
from pathlib import Path

import numpy as np
import pytest

from lumitree.core.files import (
    WriteError,
    atomic_path,
    check_room,
    check_writable,
    exclusive,
    write_json,
)
from lumitree.core.images import check_image_name, read_exr, write_exr
from lumitree.core.mitsuba_meshes import make_mesh
from lumitree.core.reading import read_bytes
from lumitree.core.work_folder import atomic_files, check_new_folder, scratch_folder
from lumitree.errors import LumitreeError


def test_failure_leaves_nothing_behind(tmp_path):
    target = tmp_path / "a.txt"
    target.write_text("before")
    with contextlib.suppress(RuntimeError), atomic_path(target) as temporary:
        temporary.write_text("half")
        raise RuntimeError
    assert target.read_text() == "before"
    assert os.listdir(tmp_path) == ["a.txt"]


@pytest.mark.parametrize("exists", [True, False])
@pytest.mark.parametrize("folder", [".", "other"])
def test_links_are_followed(tmp_path, folder, exists):
    """Also a link that leads to no file yet, and one in a chain; the links themselves stay."""
    (tmp_path / "other").mkdir()
    target = tmp_path / folder / "target.json"
    if exists:
        target.write_text("before")
    links = [tmp_path / "a.json", tmp_path / "b.json"]
    links[0].symlink_to(os.path.join(folder, "target.json"))
    links[1].symlink_to(links[0])
    for link in links:
        check_writable(link)
        write_json(link, {"at": link.name})
        assert json.loads(target.read_text()) == {"at": link.name}
        with atomic_files(link) as files:
            (files / link.name).write_text("of several")
        assert target.read_text() == "of several"
    assert all(link.is_symlink() for link in links)
    assert not target.is_symlink()
    assert len([each for each in tmp_path.rglob("*") if each.is_file()]) == 3


def test_what_is_no_file_is_refused(tmp_path):
    """And stays as it is."""
    os.mkfifo(tmp_path / "pipe")
    (tmp_path / "folder").mkdir()
    (tmp_path / "loop").symlink_to("loop")
    with socket.socket(socket.AF_UNIX) as made:
        made.bind(str(tmp_path / "socket"))
    before = {each: each.lstat() for each in tmp_path.iterdir()}
    for name, message in (
        ("pipe", "it is a pipe, a socket or a disk; choose a file"),
        ("socket", "it is a pipe, a socket or a disk; choose a file"),
        ("folder", "it is a folder"),
        ("loop", "symbolic links"),
    ):
        for write in (check_writable, lambda path: write_json(path, {})):
            with pytest.raises(LumitreeError, match=f"^cannot write .*{name}: .*{message}"):
                write(tmp_path / name)
    with pytest.raises(LumitreeError, match="pipe is no folder"):
        check_new_folder(tmp_path / "pipe")
    assert {each: each.lstat() for each in tmp_path.iterdir()} == before


def test_names_are_utf8(tmp_path):
    """Libraries take no others, each with an exception of its own."""
    name = tmp_path / "a\udcff.json"
    for function in (
        check_writable,
        lambda path: write_json(path, {}),
        lambda path: read_bytes(path, "a file", 1),
    ):
        with pytest.raises(LumitreeError, match=r"^the name .*a\?.json is not valid UTF-8") as told:
            function(name)
        assert str(told.value).isprintable()
    assert os.listdir(tmp_path) == []


def test_a_device_is_written_to():
    """A terminal here: in its folder nothing could be renamed."""
    end, terminal = os.openpty()
    tty.setraw(terminal)
    name = os.ttyname(terminal)
    check_writable(name)
    write_json(name, {"a": 1})
    assert json.loads(os.read(end, 100)) == {"a": 1}
    os.close(terminal)
    os.close(end)


@pytest.mark.parametrize(("stream", "redirected"), [("stdout", True), ("stderr", False)])
def test_standard_output_is_written_to(tmp_path, stream, redirected):
    """Behind what was printed before, also where it is redirected to a file."""
    link, found = tmp_path / "link.json", tmp_path / "found"
    link.symlink_to(f"/dev/{stream}")
    code = (
        "import sys\n"
        "from lumitree.core.files import check_writable, write_json\n"
        f"print('before', file=sys.{stream})\n"
        "for name in sys.argv[1:]:\n"
        "    check_writable(name)\n"
        "    write_json(name, {})\n"
        f"print('after', file=sys.{stream})\n"
    )
    names = [link, found] if redirected else [link]
    with open(found, "wb") as file:
        process = subprocess.run(
            [sys.executable, "-c", code, *names],
            **{stream: file if redirected else subprocess.PIPE},
            check=True,
        )
    content = found.read_bytes() if redirected else getattr(process, stream)
    assert content.split() == [b"before", *[b"{}"] * len(names), b"after"]
    assert sorted(each.name for each in tmp_path.iterdir()) == ["found", "link.json"]
    assert link.is_symlink()


def test_json_refuses_nan(tmp_path):
    for number in ("nan", "inf", "-inf"):
        with pytest.raises(LumitreeError, match=r"is not finite, and no file is written .*JSON"):
            write_json(tmp_path / "a.json", {"x": [float(number)]})
    assert os.listdir(tmp_path) == []


def test_exr_round_trip(tmp_path):
    random = np.random.default_rng(0)
    planes = {
        "RGB": random.normal(size=(5, 7, 3)).astype(np.float32),
        "geometric": random.random((5, 7), np.float32),
    }
    write_exr(tmp_path / "a.exr", planes)
    read = read_exr(tmp_path / "a.exr")
    assert read.keys() == planes.keys()
    assert all(np.array_equal(read[name], planes[name]) for name in planes)


def test_bad_exr_files_are_refused(tmp_path):
    with pytest.raises(LumitreeError, match="does not exist"):
        read_exr(tmp_path / "no.exr")
    (tmp_path / "text.exr").write_text("not an image")
    with pytest.raises(LumitreeError, match="not a readable OpenEXR"):
        read_exr(tmp_path / "text.exr")
    write_exr(tmp_path / "nan.exr", {"RGB": np.full((2, 2, 3), np.nan, np.float32)})
    with pytest.raises(LumitreeError, match="NaN"):
        read_exr(tmp_path / "nan.exr")


def test_image_names():
    for name in ("a.png", "folder/A.EXR"):
        check_image_name(name)
    with pytest.raises(LumitreeError, match=r"neither \.exr"):
        check_image_name("a.jpg")


def test_what_a_killed_process_left_is_removed(tmp_path):
    """And nothing else: neither what a living process writes nor files of like names."""
    code = (
        "import sys, time\n"
        "from lumitree.core.files import atomic_path\n"
        "with atomic_path(sys.argv[1]) as temporary:\n"
        "    print(temporary, flush=True)\n"
        "    time.sleep(600)\n"
    )
    target = tmp_path / "a.txt"
    processes = [
        subprocess.Popen([sys.executable, "-c", code, str(target)], stdout=subprocess.PIPE)
        for _ in range(2)
    ]
    killed, living = (Path(process.stdout.readline().decode().strip()) for process in processes)
    others = [tmp_path / ".a.lumitree-notes.txt", tmp_path / ".b.lumitree-12345678.txt"]
    for other in others:
        other.write_text("mine")
    try:
        processes[0].kill()
        processes[0].wait()
        assert killed.exists()
        with atomic_path(target) as temporary:
            temporary.write_text("whole")
        assert sorted(tmp_path.iterdir()) == sorted([target, living, *others])
    finally:
        processes[1].kill()
        for process in processes:
            process.communicate()


def test_outputs_that_cannot_be_written_are_refused_before(tmp_path):
    (tmp_path / "file").write_text("")
    for name, message in (
        ("file/a.txt", "Not a directory"),
        ("file/b/a.txt", "Not a directory"),
        (".", "it is a folder"),
        ("x" * 250 + ".txt", "File name too long"),
        ("a\0b.txt", "null"),
    ):
        with pytest.raises(LumitreeError, match=message):
            check_writable(tmp_path / name)
    check_writable(tmp_path / "new" / "a.txt")
    check_writable(tmp_path / "file")
    assert os.listdir(tmp_path) == ["file"]


def test_small_files_are_not_lost_silently(mi, tmp_path):
    """OpenEXR and Mitsuba write them when they close them, and do not report that it failed."""
    mesh = make_mesh("few", {"vertices": np.eye(3), "faces": [[0, 1, 2]]})
    with largest_file(100):
        with pytest.raises(WriteError, match=r"cannot write .*/a.exr: File too large; free some"):
            write_exr(tmp_path / "a.exr", {"RGB": np.ones((8, 8, 3), np.float32)})
        with (
            pytest.raises(WriteError, match=r"cannot write .*/a.ply: File too large; free some"),
            atomic_path(tmp_path / "a.ply") as temporary,
        ):
            mesh.write_ply(str(temporary))
    assert os.listdir(tmp_path) == []


@contextlib.contextmanager
def largest_file(size):
    """Files cannot be larger than `size`, as if the disk was full then."""
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(
    "error",
    [
        OSError(errno.EDQUOT, os.strerror(errno.EDQUOT), "/tmp/.a.lumitree-12345678.txt"),
        OSError(None, "Error while serializing: I/O error: Disk quota exceeded (os error 122)"),
        RuntimeError('[FileStream] "x": I/O error while writing: Disk quota exceeded'),
        ValueError("RESOURCE_EXHAUSTED: Error writing \"x\": Disk quota exceeded [os_error='122']"),
        LumitreeError("blender ended with status 1: Disk quota exceeded"),
    ],
)
def test_all_libraries_messages_of_a_full_disk_become_one(tmp_path, error):
    target = tmp_path / "a b é.txt"
    with pytest.raises(WriteError) as raised, atomic_path(target):
        raise error
    expected = f"cannot write {target}: Disk quota exceeded; free some space or choose another"
    assert str(raised.value) == f"{expected} output"
    assert raised.value.full


def test_room_is_checked_before(tmp_path):
    check_room(tmp_path / "new", 1 << 20)
    with largest_file(1000), pytest.raises(WriteError, match="File too large; free some space"):
        check_room(tmp_path / "new", 1 << 20)
    assert os.listdir(tmp_path / "new") == []


def test_one_process_at_a_time_holds_a_name(tmp_path):
    path = tmp_path / "new" / "a.lock"
    with exclusive(path) as first:
        with exclusive(path) as second:
            assert (first, second) == (True, False)
        assert path.exists()
    assert not path.exists()
    # As a killed process leaves it.
    path.touch()
    with exclusive(path) as third:
        assert third
    assert not path.exists()


def test_temporary_files_are_not_named(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    message = f"cannot write temporary files in {tmp_path}: File too large; free some space or name"
    with (
        scratch_folder() as folder,
        largest_file(1000),
        pytest.raises(WriteError, match=message + " another folder with TMPDIR"),
    ):
        write_json(folder / "meshes" / "a.json", list(range(1000)))
