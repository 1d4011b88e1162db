"""What differs between operating systems, with the rules of Windows where they can be had."""

from pathlib import Path

import pytest

from lumitree.core import system
from support.windows_rules import run_by_windows_rules


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
