"""What differs between operating systems, with the rules of Windows where they can be had."""

import ctypes
from pathlib import Path
from types import SimpleNamespace

import pytest

from lumitree.core import system
from support.windows_rules import run_by_windows_rules, run_script_without_posix


def test_this_system_has_what_it_should():
    assert system.peak_memory_bytes() > 10_000_000
    assert system.longest_name(Path()) >= 143
    assert not system.is_read_only(Path())
    assert not system.is_closed_terminal(0)


def test_the_fallbacks_take_over(tmp_path):
    result = run_by_windows_rules(
        """
        import os, signal
        from lumitree.core import system
        handle = os.open("a", os.O_CREAT | os.O_RDWR)
        print(system.lock(handle), system.keep(handle), system.open_folder("."))
        print(system.is_running(0))
        print(system.peak_memory_bytes(), system.longest_name("."), system.is_read_only("."))
        print(system.is_closed_terminal(0), system.STOP_SIGNALS == (signal.SIGINT, signal.SIGBREAK))
        os.replace("a", "b")
        """,
        tmp_path,
    )
    assert result.stdout.splitlines() == ["None None None", "True", "0 255 False", "False True"]


def test_files_that_others_have_open_are_replaced_a_little_later(tmp_path):
    result = run_by_windows_rules(
        """
        import os, threading, time
        from pathlib import Path
        from lumitree.core import files, system

        # However busy the machine is.
        system._PATIENCE_SECONDS = 50

        def closed_soon(name):
            Path(name).write_text("old")
            handle = os.open(name, os.O_RDONLY)
            threading.Timer(0.3, os.close, [handle]).start()

        closed_soon("file.txt")
        files.write_bytes("file.txt", b"new")
        closed_soon("other.txt")
        files.remove(Path("other.txt"))
        print(Path("file.txt").read_text(), os.listdir("."))
        """,
        tmp_path,
    )
    assert result.stdout == "new ['file.txt']\n"


def test_a_file_that_stays_open_is_an_error_by_windows_rules(tmp_path):
    result = run_by_windows_rules(
        """
        import os
        from pathlib import Path
        from lumitree.core import files

        Path("file.txt").write_text("old")
        with open("file.txt"):
            try:
                files.write_bytes("file.txt", b"new")
            except files.WriteError as error:
                print(error)
        print(Path("file.txt").read_text(), os.listdir("."))
        """,
        tmp_path,
    )
    first, second = result.stdout.splitlines()
    assert first.startswith("cannot write file.txt: it is used")
    assert second == "old ['file.txt']"


@pytest.mark.parametrize(
    "name", ["a:b.exr", "what?.png", "con", "NUL.exr", "com1.ies", "lamp.", "lamp ", "a\tb"]
)
def test_names_that_windows_refuses(tmp_path, name):
    result = run_by_windows_rules(
        f"""
        from lumitree.core import files
        from lumitree.errors import LumitreeError

        files.check_writable("console.exr")
        try:
            files.check_writable({name!r})
        except LumitreeError as error:
            print(error)
        """,
        tmp_path,
    )
    assert "no files with such a name" in result.stdout


def test_a_folder_that_cannot_be_written_is_found_by_windows_rules(tmp_path):
    """There `os.access` says that every folder can be written."""
    result = run_by_windows_rules(
        """
        import os
        from pathlib import Path
        from lumitree.core import files
        from lumitree.errors import LumitreeError

        opened = os.open
        def refused(path, *arguments, **options):
            if "full" in str(path):
                raise PermissionError(13, "refused", path)
            return opened(path, *arguments, **options)
        os.open = refused
        Path("full").mkdir()
        files.check_writable("file.txt")
        try:
            files.check_writable("full/file.txt")
        except LumitreeError as error:
            print(error, os.listdir("."), os.listdir("full"))
        """,
        tmp_path,
    )
    assert result.stdout.startswith("cannot write full/file.txt: Permission denied")
    assert result.stdout.endswith("['full'] []\n")


@pytest.mark.parametrize(
    ("handle", "error", "waited", "expected"),
    [(7, 0, 0x102, True), (7, 0, 0, False), (0, 87, None, False), (0, 5, None, True)],
    ids=["it runs", "it has ended", "there is none", "of another user"],
)
def test_processes_of_windows(monkeypatch, handle, error, waited, expected):
    """By the answers that Windows documents for OpenProcess and WaitForSingleObject."""
    closed = []
    kernel = SimpleNamespace(
        OpenProcess=lambda *_: handle,
        WaitForSingleObject=lambda *_: waited,
        CloseHandle=closed.append,
    )
    monkeypatch.setattr(ctypes, "get_last_error", lambda: error, raising=False)
    assert system._is_running(kernel, 12) is expected
    assert closed == ([handle] if handle else [])


def test_a_pool_stops_its_tasks_without_posix(tmp_path):
    """Where `terminate` would end them at once, a task is interrupted, and can save its state."""
    result = run_script_without_posix(
        """
        import time
        from pathlib import Path

        from lumitree._version import __version__
        from lumitree.core.executor import _run
        from lumitree.core.process_pool import process_pool

        def work(number):
            try:
                Path(f"{number} begun").touch()
                end = time.monotonic() + 600
                while time.monotonic() < end:
                    time.sleep(0.01)
            finally:
                Path(f"{number} saved").touch()

        if __name__ == "__main__":
            try:
                with process_pool(1) as executor:
                    for number in range(3):
                        executor.submit(_run, __version__, None, work, (number,))
                    while not Path("0 begun").exists():
                        time.sleep(0.01)
                    raise ZeroDivisionError
            except ZeroDivisionError:
                print(sorted(path.name for path in Path().glob("[0-9]*")))
        """,
        tmp_path,
        timeout=120,
    )
    assert result.stdout == "['0 begun', '0 saved']\n"


def test_files_and_folders_are_atomic_by_windows_rules(tmp_path):
    run_by_windows_rules(
        """
        import os
        from pathlib import Path
        from lumitree.core import files, work_folder
        from lumitree.errors import LumitreeError

        for text in ("first", "second"):
            files.write_bytes("file.txt", text.encode())
        assert Path("file.txt").read_text() == "second"
        files.check_writable("file.txt")
        with files.exclusive(Path("folder") / "lock", wait=True) as held:
            assert held
        with work_folder.alone_in(Path("alone")):
            files.write_bytes("alone/file.txt", b"x")
        with work_folder.WorkFolder("work") as work:
            (work.path / "state.npz").write_text("x")
        with work_folder.WorkFolder("work") as work:
            work.remove(["state.npz"])
        with work_folder.scratch_folder() as scratch:
            (scratch / "a").write_text("x")
        assert not scratch.exists()
        Path("lamps").mkdir()
        with work_folder.atomic_folder(Path("lamps")) as inside:
            (inside / "a.ies").write_text("x")
        with work_folder.atomic_files(Path("lamps") / "lamp.rad") as inside:
            for name in ("lamp.rad", "lamp.dat"):
                (inside / name).write_text("x")
        try:
            with files.atomic_path(Path("file.txt")):
                raise ZeroDivisionError
        except ZeroDivisionError:
            pass
        """,
        tmp_path,
    )
    found = sorted(path.relative_to(tmp_path).as_posix() for path in tmp_path.rglob("*"))
    assert found == [
        "alone",
        "alone/file.txt",
        "file.txt",
        "folder",
        "lamps",
        "lamps/a.ies",
        "lamps/lamp.dat",
        "lamps/lamp.rad",
    ]


@pytest.mark.parametrize("number", ["SIGINT", "SIGBREAK"])
def test_stop_signals_by_windows_rules(tmp_path, number):
    """Also one that a library has caught: it is raised again without a timer of the system."""
    result = run_by_windows_rules(
        f"""
        import signal, time
        from lumitree.core.interrupt import Interrupted, deferred_interrupt, interruptible

        def work():
            with interruptible():
                try:
                    signal.raise_signal(signal.{number})
                except BaseException:
                    print("caught")
                # Where there is no timer, a call of the system is not cut short.
                end = time.monotonic() + 20
                while time.monotonic() < end:
                    time.sleep(0.01)

        try:
            work()
        except Interrupted as error:
            print(error.number == signal.{number})
        with interruptible(), deferred_interrupt() as stop:
            signal.raise_signal(signal.{number})
            print(bool(stop))
        before = signal.getsignal(signal.SIGTERM)
        time.sleep(0.1)
        print(before is signal.SIG_DFL)
        """,
        tmp_path,
        timeout=25,
    )
    assert result.stdout.split() == ["caught", "True", "True", "True"]
    assert result.stderr.count("stopping ...") == 2
