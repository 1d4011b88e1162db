"""Files appear whole or not at all; folders that lumitree owns, and files that it never deletes."""

# pyright: reportPossiblyUnboundVariable=false
import contextlib
import errno
import fcntl
import gc
import json
import os
import resource
import shutil
import socket
import subprocess
import sys
import tempfile
import tty
from pathlib import Path

import numpy as np
import pytest

from lumitree.core.files import (
    MARKER,
    BusyFolderError,
    ScratchFolder,
    WorkFolder,
    WriteError,
    atomic_files,
    atomic_folder,
    atomic_path,
    check_new_folder,
    check_writable,
    exclusive,
    scratch_folder,
    write_bytes,
    write_json,
)
from lumitree.core.images import write_exr
from lumitree.core.mitsuba_meshes import make_mesh
from lumitree.core.reading import read_bytes
from lumitree.errors import LumitreeError, LumitreeWarning


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


def test_temporary_files_are_not_named(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    message = f"cannot write temporary files in {tmp_path}: File too large; free some space or name"
    with (
        scratch_folder() as folder,
        largest_file(1000),
        pytest.raises(WriteError, match=message + " another folder with TMPDIR"),
    ):
        write_json(folder / "meshes" / "a.json", list(range(1000)))


NAMES = ["state.npz", "dataset/view_*.exr", "run/checkpoints/[0-9]*"]


def fill(folder):
    """Files that lumitree writes."""
    for name in ("state.npz", "dataset/view_1.exr", "run/checkpoints/10/item/data"):
        (folder / name).parent.mkdir(parents=True, exist_ok=True)
        (folder / name).write_text("x")


def test_finished_work_leaves_nothing(tmp_path):
    with WorkFolder(tmp_path / "a" / "w") as work:
        fill(work.path)
        work.remove(NAMES)
    assert os.listdir(tmp_path / "a") == []


def test_unfinished_work_stays_and_is_found_again(tmp_path):
    with WorkFolder(tmp_path / "w") as work:
        (work.path / "state.npz").write_text("x")
    with WorkFolder(tmp_path / "w") as work:
        assert (work.path / "state.npz").read_text() == "x"
        assert (work.path / MARKER).stat().st_size > 0


@pytest.mark.parametrize("existed", [False, True])
def test_work_that_came_to_nothing_leaves_no_trace(tmp_path, existed):
    if existed:
        (tmp_path / "w").mkdir()
    with pytest.raises(ZeroDivisionError), WorkFolder(tmp_path / "w"):
        raise ZeroDivisionError
    assert (tmp_path / "w").exists() == existed
    assert not (tmp_path / "w" / MARKER).exists()


@pytest.mark.parametrize("name", ["precious.txt", "run/a", ".hidden"])
def test_folders_of_others_are_refused(tmp_path, name):
    path = tmp_path / "w" / name
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    with pytest.raises(LumitreeError, match="holds what lumitree did not write"):
        WorkFolder(tmp_path / "w")
    assert path.read_text() == "mine"


@pytest.mark.parametrize("name", ["precious.txt", "run/mine", "run/checkpoints/mine.txt"])
def test_only_what_lumitree_wrote_is_removed(tmp_path, name):
    with WorkFolder(tmp_path / "w") as work:
        fill(work.path)
        (work.path / name).write_text("mine")
        with pytest.warns(LumitreeWarning, match="stays"):
            work.remove(NAMES)
    left = sorted(str(path.relative_to(work.path)) for path in work.path.rglob("*"))
    assert [entry for entry in left if (work.path / entry).is_file()] == sorted([MARKER, name])


def test_files_of_a_desktop_do_not_count(tmp_path):
    """As the Finder of macOS and the Explorer of Windows add them to folders that they show."""
    for name in ("work", "new"):
        (tmp_path / name).mkdir()
        (tmp_path / name / ".DS_Store").touch()
    check_new_folder(tmp_path / "new")
    with atomic_folder(tmp_path / "new") as inside:
        (inside / "lamp.ies").touch()
    assert os.listdir(tmp_path / "new") == ["lamp.ies"]
    with WorkFolder(tmp_path / "work") as work:
        fill(work.path)
        (work.path / "dataset" / "desktop.ini").touch()
        work.remove(NAMES)
    assert not (tmp_path / "work").exists()


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "w").write_text("mine")
    with pytest.raises(LumitreeError, match="cannot write the work folder"):
        WorkFolder(tmp_path / "w")


def test_a_full_disk_leaves_no_marker(tmp_path, monkeypatch):
    def fail(*_):
        raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))

    monkeypatch.setattr(Path, "write_text", fail)
    message = "cannot write the work folder .*: No space left on device; free some space or choose"
    with pytest.raises(LumitreeError, match=message + " another with --work"):
        WorkFolder(tmp_path / "w")
    assert os.listdir(tmp_path) == []


def test_one_process_at_a_time(tmp_path):
    with WorkFolder(tmp_path / "w"), pytest.raises(LumitreeError, match="another process works"):
        WorkFolder(tmp_path / "w")


def test_one_process_at_a_time_works_in_a_folder_of_results(tmp_path):
    with exclusive(tmp_path / "new" / "d"):
        message = r"^another process works in .*/new/d; wait for it, or choose another output with"
        with pytest.raises(BusyFolderError, match=message), exclusive(tmp_path / "new" / "d"):
            pass
    with exclusive(tmp_path / "new" / "d"):
        assert os.listdir(tmp_path / "new" / "d") == []
    (tmp_path / "file").touch()
    exists = r"cannot write .*: File exists"
    with pytest.raises(LumitreeError, match=exists), exclusive(tmp_path / "file"):
        pass


def test_scratch_folders_last_as_long_as_their_objects(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    kept = ScratchFolder()
    files = len(os.listdir("/proc/self/fd")) if os.path.isdir("/proc/self/fd") else None
    for _ in range(10):
        last = ScratchFolder()
        (last.path / "a").write_text("x")
    gc.collect()
    assert sorted(kept.path.parent.iterdir()) == sorted(
        [kept.path, last.path, kept.path.parent / MARKER]
    )
    # All are under one lock.
    assert files is None or len(os.listdir("/proc/self/fd")) == files
    # Systems remove old temporary files.
    shutil.rmtree(kept.path.parent)
    assert ScratchFolder().path.parent != kept.path.parent


KILLED = """
import sys, time
from lumitree.core.files import atomic_path, scratch_folder
with atomic_path(sys.argv[1]) as temporary, scratch_folder() as folder:
    (folder / "a").write_text("x")
    print(temporary, folder, flush=True)
    time.sleep(600)
"""


def test_files_and_folders_of_killed_processes_are_removed(tmp_path, monkeypatch):
    """And nothing else: neither folders of a living process nor folders with similar names."""
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path / "tmp"))
    others = [".a.lumitree-notes.txt", ".b.lumitree-12345678.txt", "tmp/lumitree-scratch-mine/a"]
    for other in others:
        (tmp_path / other).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / other).write_text("mine")
    # A process was killed before it locked this folder.
    (tmp_path / "tmp" / "lumitree-scratch-00000000").mkdir()
    command = [sys.executable, "-c", KILLED, str(tmp_path / "a.txt")]
    environment = os.environ | {"TMPDIR": str(tmp_path / "tmp")}
    processes = [
        subprocess.Popen(command, stdout=subprocess.PIPE, env=environment, text=True)
        for _ in range(2)
    ]
    killed, living = ([Path(each) for each in p.stdout.readline().split()] for p in processes)
    try:
        processes[0].kill()
        processes[0].wait()
        assert all(path.exists() for path in killed)
        with atomic_path(tmp_path / "a.txt") as temporary, scratch_folder() as scratch:
            temporary.write_text("whole")
            assert all(path.exists() for path in living)
        assert not scratch.exists()
        files = {path for path in tmp_path.rglob("*") if path.is_file()}
        expected = {tmp_path / name for name in ("a.txt", *others)}
        expected |= {living[0], living[1] / "a", living[1] / MARKER}
        assert files == expected
        assert not (tmp_path / "tmp" / "lumitree-scratch-00000000").exists()
    finally:
        for process in processes:
            process.kill()
            process.communicate()


def write_set(folder, text="new"):
    for name in ("lamp.rad", "lamp.r.dat", "lamp.zz.dat"):
        (folder / name).write_text(text)


def test_files_of_an_output_appear_together_and_replace_older_ones(tmp_path):
    write_set(tmp_path, "old")
    (tmp_path / "other").write_text("mine")
    with atomic_files(tmp_path / "lamp.rad") as folder:
        write_set(folder)
        assert (tmp_path / "lamp.rad").read_text() == "old"
    assert sorted(os.listdir(tmp_path)) == ["lamp.r.dat", "lamp.rad", "lamp.zz.dat", "other"]
    assert (tmp_path / "lamp.rad").read_text() == (tmp_path / "lamp.zz.dat").read_text() == "new"


def test_files_of_a_folder_beside_an_output_replace_older_ones(tmp_path):
    for text in ("old", "new"):
        with atomic_files(tmp_path / "lamp.rad") as folder:
            (folder / "lamp_files").mkdir()
            (folder / "lamp_files/lamp.rad").write_text(text)
            (folder / "lamp.rad").write_text(text)
        (tmp_path / "lamp_files/other").write_text("mine")
    assert sorted(os.listdir(tmp_path)) == ["lamp.rad", "lamp_files"]
    assert (tmp_path / "lamp_files/lamp.rad").read_text() == "new"
    assert (tmp_path / "lamp_files/other").read_text() == "mine"


@pytest.mark.parametrize("write", [atomic_files, atomic_folder])
def test_files_that_failed_leave_no_trace(tmp_path, write):
    def fail(error):
        with write(tmp_path / "out") as folder:
            write_set(folder)
            raise error

    with pytest.raises(ZeroDivisionError):
        fail(ZeroDivisionError())
    with pytest.raises(LumitreeError, match=r"cannot write .*out: No space left"):
        fail(OSError(errno.ENOSPC, os.strerror(errno.ENOSPC)))
    # The message names the output, whatever file of it failed.
    with (
        pytest.raises(LumitreeError, match=r"cannot write [^ ]*/out: File name too long"),
        write(tmp_path / "out") as folder,
    ):
        write_bytes(folder / ("x" * 300), b"")
    assert os.listdir(tmp_path) == []


def test_a_folder_appears_whole(tmp_path):
    for name in ("new/out", "empty"):
        (tmp_path / "empty").mkdir(exist_ok=True)
        with atomic_folder(tmp_path / name) as folder:
            write_set(folder)
        assert len(os.listdir(tmp_path / name)) == 3
    # The user's umask applies, as to every output.
    umask = os.umask(0)
    os.umask(umask)
    assert (tmp_path / "empty").stat().st_mode & 0o777 == 0o777 & ~umask


def test_folders_that_hold_something_are_refused(tmp_path, monkeypatch):
    (tmp_path / "full").mkdir()
    (tmp_path / "full" / "mine").write_text("")
    for name, message in (("full", "holds mine"), ("full/mine", "is no folder")):
        with pytest.raises(LumitreeError, match=message):
            check_new_folder(tmp_path / name)
    with pytest.raises(LumitreeError, match="Not a directory"):
        check_new_folder(tmp_path / "full" / "mine" / "out")
    check_new_folder(tmp_path / "new" / "out")
    (tmp_path / "here").mkdir()
    monkeypatch.chdir(tmp_path / "here")
    with pytest.raises(LumitreeError, match="current folder"):
        check_new_folder(Path("."))
    assert sorted(os.listdir(tmp_path)) == ["full", "here"]


@pytest.mark.parametrize("hold", [WorkFolder, exclusive])
def test_a_folder_that_its_owner_removes_meanwhile_is_made_again(tmp_path, monkeypatch, hold):
    """Another process removes the folder just before this one locks it."""
    lock = fcntl.flock

    def remove_and_lock(*args):
        monkeypatch.undo()
        shutil.rmtree(tmp_path / "w")
        lock(*args)

    monkeypatch.setattr(fcntl, "flock", remove_and_lock)
    with hold(tmp_path / "w"):
        assert (tmp_path / "w").is_dir()
        with pytest.raises(BusyFolderError), hold(tmp_path / "w"):
            pass
