"""Signals that ask a job to stop."""

import contextlib
import signal
import subprocess
import sys
import time

import pytest

from lumitree.core.interrupt import STOP_SIGNALS, Interrupted, deferred_interrupt, interruptible

# Longer than any test waits: a signal ends it.
LONG = 60.0


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_a_signal_ends_the_block_at_once(number, capfd):
    before, reached = signal.getsignal(number), []

    def work():
        with interruptible():
            signal.raise_signal(number)
            reached.append("after")

    with pytest.raises(Interrupted) as raised:
        work()
    assert reached == []
    assert raised.value.number == number
    assert "stopping ..." in capfd.readouterr().err
    assert signal.getsignal(number) is before


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_a_deferred_signal_is_noted_and_a_second_one_ends(number, capfd):
    reached = []

    def work():
        with interruptible(), deferred_interrupt() as stop:
            reached.append((bool(stop), stop.number))
            signal.raise_signal(number)
            reached.append((bool(stop), stop.number))
            signal.raise_signal(number)
            reached.append("after")

    with pytest.raises(Interrupted):
        work()
    assert reached == [(False, None), (True, number)]
    assert "a second signal ends at once" in capfd.readouterr().err


def test_ignored_signals_stay_ignored():
    before = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with interruptible(), deferred_interrupt() as stop:
            signal.raise_signal(signal.SIGHUP)
            assert not stop
        assert signal.getsignal(signal.SIGHUP) is signal.SIG_IGN
    finally:
        signal.signal(signal.SIGHUP, before)


def test_a_signal_in_an_import_is_raised_after_it(tmp_path, monkeypatch):
    """A module that is half imported is broken, and trimesh catches what its imports raise."""
    (tmp_path / "slow_module.py").write_text(
        "import signal\nsignal.raise_signal(signal.SIGTERM)\ncomplete = True\n"
    )
    monkeypatch.syspath_prepend(tmp_path)
    reached = []

    def work():
        with interruptible():
            import slow_module  # pyright: ignore[reportMissingImports]

            reached.append(slow_module.complete)
            time.sleep(LONG)

    with pytest.raises(Interrupted) as raised:
        work()
    assert reached == [True]
    assert raised.value.number == signal.SIGTERM


def test_a_signal_that_a_library_catches_is_raised_again():
    def catch_all():
        try:
            signal.raise_signal(signal.SIGINT)
        except BaseException:
            return

    reached = []

    def work():
        with interruptible():
            catch_all()
            reached.append("caught")
            time.sleep(LONG)

    with pytest.raises(Interrupted):
        work()
    assert reached == ["caught"]


def test_a_signal_that_a_library_turns_into_its_own_error_is_a_signal():
    """As Mitsuba does while it makes a plugin."""

    def convert():
        try:
            signal.raise_signal(signal.SIGTERM)
        except BaseException:
            error = RuntimeError("failed to instantiate")
        raise error

    with pytest.raises(Interrupted) as raised, interruptible():
        convert()
    assert raised.value.number == signal.SIGTERM
    with pytest.raises(RuntimeError, match="no signal"), interruptible():
        raise RuntimeError("no signal")


def test_completed_work_ends_as_without_a_signal(monkeypatch):
    """But work around it is interrupted."""
    before = signal.getsignal(signal.SIGALRM)

    def inner():
        with interruptible(), contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)

    def outer():
        with interruptible():
            inner()
            time.sleep(LONG)

    with monkeypatch.context() as patch:
        patch.setattr("lumitree.core.interrupt._AGAIN_SECONDS", LONG)
        inner()
    with pytest.raises(Interrupted) as raised:
        outer()
    assert raised.value.number == signal.SIGTERM
    assert signal.getsignal(signal.SIGALRM) is before
    assert signal.getitimer(signal.ITIMER_REAL) == (0, 0)


PROGRAM = "import sys, signal; sys.argv[:] = ['lumitree', '--version']; import lumitree\n"


@pytest.mark.parametrize("number", STOP_SIGNALS)
def test_a_signal_before_the_command_begins_ends_the_program_with_one_line(number):
    code = PROGRAM + f"signal.raise_signal({int(number)})"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.returncode == 128 + number
    assert process.stderr == "lumitree: error: interrupted before the command began\n"


def test_a_signal_after_the_command_has_ended_changes_nothing():
    code = PROGRAM + "from lumitree.cli import main\ntry:\n    main()\nfinally:\n"
    code += "".join(f"    signal.raise_signal({int(number)})\n" for number in STOP_SIGNALS)
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert (process.returncode, process.stderr) == (0, "")
    assert process.stdout.startswith("lumitree ")


def test_other_programs_keep_their_handlers():
    code = "import signal, lumitree; print(signal.getsignal(signal.SIGTERM) is signal.SIG_DFL)"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.stdout == "True\n"
