"""Claims of lamps: who works on one, and when a claim is abandoned."""

import errno
import fcntl
import json
import os
import signal
import socket
import subprocess
import sys
import time

import pytest

from lumitree.core import files
from lumitree.core.files import WriteError
from lumitree.fit.catalogue import claim
from lumitree.fit.catalogue.claim import Owner, claimed
from support.windows_rules import run_by_windows_rules

HOLD = """
import sys
from pathlib import Path
from lumitree.fit.catalogue.claim import claimed
with claimed(Path(sys.argv[1])) as owner:
    print(owner, flush=True)
    sys.stdin.readline()
"""


@pytest.fixture
def path(tmp_path):
    return tmp_path / "new" / "a.claim"


def hold(path):
    """A process that has the claim."""
    process = subprocess.Popen(
        [sys.executable, "-c", HOLD, path],
        stdin=subprocess.PIPE,
        stdout=subprocess.PIPE,
        text=True,
    )
    assert process.stdout.readline() == "None\n"
    return process


def write(path, host, process=1, age=0.0):
    """A claim that is not locked."""
    path.parent.mkdir(exist_ok=True)
    path.write_text(json.dumps({"host": host, "process": process, "since": 0.0}))
    then = time.time() - age
    os.utime(path, (then, then))


@pytest.fixture
def without_locks(monkeypatch):
    """A file system that has none."""

    def flock(*_):
        raise OSError(errno.ENOSYS, "Function not implemented")

    monkeypatch.setattr(fcntl, "flock", flock)
    assert files.lock(0) is None


def test_a_second_process_learns_who_has_it(path):
    process = hold(path)
    with claimed(path) as owner:
        assert (owner.host, owner.process) == (socket.gethostname(), process.pid)
        assert f"process {process.pid} on {socket.gethostname()} (since 20" in str(owner)
    assert path.exists()
    process.communicate("\n")
    assert not path.exists()
    with claimed(path) as owner:
        assert owner is None
        assert path.exists()
    assert not path.exists()


def test_a_killed_process_has_nothing(path):
    process = hold(path)
    process.send_signal(signal.SIGKILL)
    process.communicate()
    assert path.exists()
    with claimed(path) as owner:
        assert owner is None
        assert json.loads(path.read_text())["process"] == os.getpid()
    assert not path.exists()


def test_an_error_releases_it(path):
    with pytest.raises(ZeroDivisionError), claimed(path):
        raise ZeroDivisionError
    assert not path.exists()


def test_a_claim_of_another_host_is_abandoned_when_it_is_not_renewed(path):
    write(path, "elsewhere", age=500)
    with claimed(path) as owner:
        assert owner == Owner("elsewhere", 1, 0.0)
    write(path, "elsewhere", age=700)
    with claimed(path) as owner:
        assert owner is None


def test_a_claim_is_renewed(path, monkeypatch):
    monkeypatch.setattr(claim, "_RENEW_SECONDS", 0.01)
    with claimed(path):
        os.utime(path, (0, 0))
        for _ in range(1000):
            if path.stat().st_mtime > 0:
                break
            time.sleep(0.01)
        assert path.stat().st_mtime > 0


@pytest.mark.usefixtures("without_locks")
def test_without_locks_the_process_of_this_host_decides(path):
    ended = subprocess.Popen(["true"])
    ended.wait()
    write(path, socket.gethostname(), ended.pid)
    with claimed(path) as owner:
        assert owner is None
        with claimed(path) as second:
            assert second.process == os.getpid()
        assert path.exists()
    write(path, "elsewhere")
    with claimed(path) as owner:
        assert owner.host == "elsewhere"


@pytest.mark.parametrize("content", ["", "{", '{"host": "a", "process": 1e99, "since": 0}'])
def test_a_claim_that_says_nothing_is_left_for_some_seconds(path, content, monkeypatch):
    """Its process may not have written it yet, or was killed before it did."""
    # However slow the machine is.
    monkeypatch.setattr(claim, "_LOOK_SECONDS", 1000.0)
    path.parent.mkdir()
    path.write_text(content)
    with claimed(path) as owner:
        assert str(owner) == "another process"
    then = time.time() - 2000
    os.utime(path, (then, then))
    with claimed(path) as owner:
        assert owner is None


def test_a_process_that_looks_at_a_new_claim_does_not_take_it(path, monkeypatch):
    """Between its creation and its first lock."""
    looked = []

    def lock(handle):
        looked.append(handle)
        return False if len(looked) < 3 else files.lock(handle)

    monkeypatch.setattr(claim, "lock", lock)
    monkeypatch.setattr(claim, "_LOOK_SECONDS", 1000.0)
    with claimed(path) as owner:
        assert owner is None
        assert json.loads(path.read_text())["process"] == os.getpid()
    assert len(looked) == 3


@pytest.mark.parametrize("process", [-1, 0, 2**70])
@pytest.mark.usefixtures("without_locks")
def test_numbers_of_no_process_are_read(path, process):
    write(path, socket.gethostname(), process)
    with claimed(path) as owner:
        assert owner is None or owner.process == process


def test_a_claim_that_another_host_took_over_stays(path):
    """As while this process was stopped."""
    with claimed(path):
        write(path, "elsewhere")
    assert json.loads(path.read_text())["host"] == "elsewhere"


def test_a_folder_that_cannot_be_written_is_one_line(tmp_path):
    (tmp_path / "file").write_text("")
    with pytest.raises(WriteError, match="cannot write"), claimed(tmp_path / "file" / "a.claim"):
        pass


def test_claims_by_windows_rules(tmp_path):
    result = run_by_windows_rules(
        """
        from pathlib import Path
        from lumitree.fit.catalogue.claim import claimed

        claim = Path("folder/claim")
        with claimed(claim) as first, claimed(claim) as second:
            print(first is None, second is not None, claim.exists())
        print(claim.exists())
        """,
        tmp_path,
    )
    assert result.stdout.splitlines() == ["True True True", "False"]
