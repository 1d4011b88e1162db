"""Signals that ask a job to stop, and the program `lumitree` around its command."""

import contextlib
import shlex
import signal
import subprocess
import sys

import pytest

import lumitree
from lumitree.core.interruption import (
    STOP_SIGNALS,
    Interrupted,
    deferred_interrupt,
    interruptible,
    is_program,
)
from lumitree.core.progress import progress


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


def advance(amount=1):
    with progress("work", 1) as report:
        report(amount)


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
            advance()
            reached.append("after")

    with pytest.raises(Interrupted) as raised:
        work()
    assert reached == [True]
    assert raised.value.number == signal.SIGTERM


@pytest.mark.parametrize("next_step", [advance, lambda: deferred_interrupt().__enter__()])
def test_a_signal_that_a_library_catches_is_raised_by_the_next_step(next_step):
    reached = []

    def work():
        with interruptible():
            with contextlib.suppress(BaseException):
                signal.raise_signal(signal.SIGINT)
            reached.append("caught")
            next_step()
            reached.append("after")

    with pytest.raises(Interrupted):
        work()
    assert reached == ["caught"]
    advance()


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


def test_completed_work_ends_as_without_a_signal():
    """But work around it is interrupted."""

    def inner():
        with interruptible(), contextlib.suppress(KeyboardInterrupt):
            signal.raise_signal(signal.SIGTERM)

    def outer():
        with interruptible():
            inner()
            advance()

    inner()
    with pytest.raises(Interrupted) as raised:
        outer()
    assert raised.value.number == signal.SIGTERM


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
    assert process.stdout.strip().endswith(lumitree.__version__)


def test_other_programs_keep_their_handlers():
    code = "import signal, lumitree; print(signal.getsignal(signal.SIGTERM) is signal.SIG_DFL)"
    process = subprocess.run([sys.executable, "-c", code], capture_output=True, text=True)
    assert process.stdout == "True\n"


@pytest.mark.parametrize(
    ("name", "command", "expected"),
    [
        ("/bin/lumitree", ["python", "/bin/lumitree", "bake"], True),
        (r"lumitree.exe", ["lumitree.exe", "bake"], True),
        ("-m", ["python", "-X", "utf8", "-m", "lumitree", "bake"], True),
        ("-m", ["python", "-m", "pytest", "lumitree"], False),
        ("-m", ["python", "-m", "lumitree_plugin"], False),
        ("script.py", ["python", "script.py", "-m", "lumitree"], False),
        ("", ["python"], False),
    ],
)
def test_the_command_line_is_known_by_its_name_and_as_a_module(
    monkeypatch, name, command, expected
):
    monkeypatch.setattr(sys, "argv", [name])
    monkeypatch.setattr(sys, "orig_argv", command)
    assert is_program() is expected


@pytest.mark.parametrize("closed", [">&-", "2>&-", "<&- >&- 2>&-", ">/dev/null 2>/dev/full"])
def test_streams_that_are_closed_or_full_end_no_command(tmp_path, closed):
    """Files do not get the descriptors of streams, into which messages would then be written."""
    code = (
        "import sys\n"
        "from pathlib import Path\n"
        "from lumitree.core.interruption import open_streams\n"
        "open_streams()\n"
        "file = open(sys.argv[1], 'w')\n"
        "for stream in (sys.stdout, sys.stderr):\n"
        "    print('a message', file=stream, flush=True)\n"
        "file.write('done')\n"
    )
    command = shlex.join([sys.executable, "-c", code, str(tmp_path / "a")])
    subprocess.run(["sh", "-c", f"{command} {closed}"], check=True, capture_output=True)
    assert (tmp_path / "a").read_text() == "done"


def test_commands_end_well_without_standard_output(tmp_path):
    command = shlex.join([sys.executable, "-m", "lumitree", "list", "--json", "a.json"])
    subprocess.run(["sh", "-c", f"{command} >&- 2>&-"], check=True, cwd=tmp_path)
    assert "dallas" in (tmp_path / "a.json").read_text()
