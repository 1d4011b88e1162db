"""Folders that lumitree owns, and what it never deletes."""

import errno
import gc
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from lumitree.core import work_folder
from lumitree.core.files import write_bytes
from lumitree.core.work_folder import (
    MARKER,
    BusyFolderError,
    ScratchFolder,
    WorkFolder,
    alone_in,
    atomic_files,
    atomic_folder,
    check_new_folder,
    scratch_folder,
)
from lumitree.errors import LumitreeError, LumitreeWarning

NAMES = ["state.npz", "dataset/view_*.exr", "run/checkpoints/[0-9]*"]


def fill(folder):
    """What lumitree writes."""
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

    monkeypatch.setattr(os, "write", fail)
    message = "cannot write the work folder .*: No space left on device; free some space or choose"
    with pytest.raises(LumitreeError, match=message + " another with --work"):
        WorkFolder(tmp_path / "w")
    assert os.listdir(tmp_path) == []


def test_one_process_at_a_time(tmp_path):
    with WorkFolder(tmp_path / "w"), pytest.raises(LumitreeError, match="another process works"):
        WorkFolder(tmp_path / "w")


def test_one_process_at_a_time_works_in_a_folder_of_results(tmp_path):
    with alone_in(tmp_path / "new" / "d"):
        message = r"^another process works in .*/new/d; wait for it, or choose another output with"
        with pytest.raises(BusyFolderError, match=message), alone_in(tmp_path / "new" / "d"):
            pass
    with alone_in(tmp_path / "new" / "d"):
        assert os.listdir(tmp_path / "new" / "d") == []
    (tmp_path / "file").touch()
    exists = r"cannot write .*: File exists"
    with pytest.raises(LumitreeError, match=exists), alone_in(tmp_path / "file"):
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


def test_scratch_folders_of_killed_processes_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "lumitree-scratch-somebody").mkdir()
    (tmp_path / "lumitree-scratch-somebody" / "mine").touch()
    # Of a process that was killed before it locked its folder.
    (tmp_path / "lumitree-scratch-__empty_").mkdir()
    code = (
        "import sys, time\n"
        "from lumitree.core.work_folder import scratch_folder\n"
        "with scratch_folder() as folder:\n"
        "    (folder / 'a').write_text('x')\n"
        "    print(folder, flush=True)\n"
        "    time.sleep(600)\n"
    )
    environment = os.environ | {"TMPDIR": str(tmp_path)}
    processes = [
        subprocess.Popen([sys.executable, "-c", code], stdout=subprocess.PIPE, env=environment)
        for _ in range(2)
    ]
    killed, living = (Path(process.stdout.readline().decode().strip()) for process in processes)
    try:
        processes[0].send_signal(signal.SIGKILL)
        processes[0].wait()
        assert killed.is_dir()
        with scratch_folder() as own:
            assert not killed.exists()
            assert not (tmp_path / "lumitree-scratch-__empty_").exists()
            assert living.is_dir()
            assert own.is_dir()
        assert not own.exists()
        assert (tmp_path / "lumitree-scratch-somebody").is_dir()
    finally:
        processes[1].kill()
        for process in processes:
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


def removed_before(function, path, monkeypatch):
    """Let another process remove a path just before the first call of a function."""
    original = getattr(work_folder, function)

    def remove_and_call(*args, **kwargs):
        monkeypatch.undo()
        shutil.rmtree(path, ignore_errors=True)
        return original(*args, **kwargs)

    monkeypatch.setattr(work_folder, function, remove_and_call)


def test_a_folder_that_its_owner_removes_meanwhile_is_made_again(tmp_path, monkeypatch):
    removed_before("lock", tmp_path / "w", monkeypatch)
    with WorkFolder(tmp_path / "w"):
        assert (tmp_path / "w" / MARKER).exists()
        with pytest.raises(BusyFolderError):
            WorkFolder(tmp_path / "w")
    removed_before("lock", tmp_path / "w", monkeypatch)
    with alone_in(tmp_path / "w"):
        assert (tmp_path / "w").is_dir()
        with pytest.raises(BusyFolderError), alone_in(tmp_path / "w"):
            pass
