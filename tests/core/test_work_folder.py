"""Folders that lumitree owns, and what it never deletes."""

import errno
import os
import shutil
import signal
import subprocess
import sys
import tempfile
from pathlib import Path

import pytest

from lumitree.core.work_folder import MARKER, WorkFolder, scratch_folder
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


def test_links_are_removed_not_followed(tmp_path):
    (tmp_path / "mine").mkdir()
    (tmp_path / "mine" / "precious.txt").write_text("mine")
    with WorkFolder(tmp_path / "w") as work:
        (work.path / "run" / "checkpoints").mkdir(parents=True)
        (work.path / "run" / "checkpoints" / "10").symlink_to(tmp_path / "mine")
        work.remove(NAMES)
    assert os.listdir(tmp_path / "mine") == ["precious.txt"]


def test_a_file_is_no_folder(tmp_path):
    (tmp_path / "w").write_text("mine")
    with pytest.raises(LumitreeError, match="cannot write the work folder"):
        WorkFolder(tmp_path / "w")


def test_a_folder_that_vanishes_is_no_obstacle(tmp_path):
    """Someone removes it while a process works in it."""
    with WorkFolder(tmp_path / "w") as work:
        shutil.rmtree(work.path)
        assert work.is_empty
        work.remove(NAMES)
    assert os.listdir(tmp_path) == []
    with WorkFolder(tmp_path / "w") as work:
        shutil.rmtree(work.path)
        fill(work.path)
    # It can be continued.
    with WorkFolder(tmp_path / "w") as work:
        assert not work.is_empty
        shutil.rmtree(work.path)
        fill(work.path)
        work.remove(NAMES)
    assert os.listdir(tmp_path) == []


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


def test_scratch_folders_of_killed_processes_are_removed(tmp_path, monkeypatch):
    monkeypatch.setattr(tempfile, "tempdir", str(tmp_path))
    (tmp_path / "lumitree-scratch-somebody").mkdir()
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
            assert living.is_dir()
            assert own.is_dir()
        assert not own.exists()
        assert (tmp_path / "lumitree-scratch-somebody").is_dir()
    finally:
        processes[1].kill()
        for process in processes:
            process.communicate()
