"""Signals that ask a job to stop."""

import os
import pty
import signal
import subprocess
import sys
import textwrap

import pytest

from lumitree.core.interrupt import STOP_SIGNALS, Interrupted, deferred_interrupt, interruptible


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


def test_output_goes_nowhere_once_the_terminal_has_gone(tmp_path):
    """As when a remote session is cut: the work is finished, and no line of it fails."""
    code = """
        import sys
        from pathlib import Path
        from lumitree.core.interrupt import deferred_interrupt
        with deferred_interrupt() as stop:
            print("ready", flush=True)
            while not stop:
                pass
        print("saved", flush=True)
        print("saved", file=sys.stderr, flush=True)
        Path(sys.argv[1]).write_text("saved")
    """
    primary, secondary = pty.openpty()
    done = tmp_path / "done"
    process = subprocess.Popen(
        [sys.executable, "-c", textwrap.dedent(code), str(done)],
        stdin=secondary, stdout=secondary, stderr=secondary, start_new_session=True,
        preexec_fn=lambda: __import__("fcntl").ioctl(0, __import__("termios").TIOCSCTTY, 0),
    )  # fmt: skip
    os.close(secondary)
    assert b"ready" in os.read(primary, 100)
    os.close(primary)
    assert process.wait(timeout=60) == 0
    assert done.read_text() == "saved"
