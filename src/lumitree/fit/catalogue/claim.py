"""Claims: which process works on a lamp of a folder that several processes, or machines, share.

A claim is a file with the host, the process and the time. It is locked while its process lives, and
renewed every minute. Where it is held to be abandoned:

* Made on this host: if it is not locked. Locks vanish with their process, however it ends. Where
  the file system has no locks: if there is no such process.
* Made on another host: if it is neither locked nor renewed for ten minutes, by the clock of the
  file system. Some network file systems keep locks between machines, and others only within one,
  so that an absent lock does not say that the process is gone.

A process that is stopped for ten minutes may lose its claim. Then two processes bake the lamp, and
write the same files, each of them whole.
"""

import contextlib
import dataclasses
import json
import os
import socket
import tempfile
import threading
import time
from collections.abc import Iterator
from pathlib import Path

from lumitree.core.files import WriteError, remove
from lumitree.core.interruption import Interrupted, deferred_interrupt
from lumitree.core.reading import Record, parse_json
from lumitree.core.system import is_running, lock, patiently
from lumitree.errors import LumitreeError, shown

_RENEW_SECONDS, _ABANDONED_SECONDS = 60.0, 600.0
# In which a process that makes a claim writes it, and another one looks at it, at most.
_LOOK_SECONDS = 5.0
_MAX_CLAIM_BYTES = 10_000


@dataclasses.dataclass(frozen=True)
class Owner:
    """Process with a claim: its machine ("" if unknown), number, and start (s since 1970)."""

    host: str
    process: int
    since: float

    def __str__(self) -> str:
        if not self.host:
            return "another process"
        when = time.strftime("%Y-%m-%d %H:%M", time.localtime(self.since))
        return f"process {self.process} on {shown(self.host, 100)} (since {when})"


UNKNOWN = Owner("", 0, 0.0)


@contextlib.contextmanager
def claimed(path: Path) -> Iterator[Owner | None]:
    """Context in which this process has the claim `path`; yields the owner if another one has it.

    Raises:
        WriteError: the folder cannot be written, or the disk is full.
        Interrupted: a signal arrived while it was taken.
    """
    try:
        # Else a signal could leave a file that stays open, and so locked.
        with deferred_interrupt() as interruption:
            taken = _take(path)
    except OSError as error:
        raise WriteError(path.parent, error) from error
    if isinstance(taken, Owner):
        yield taken
        return
    try:
        if interruption.number is not None:
            raise Interrupted(number=interruption.number)
        with _renewed(path):
            yield None
    finally:
        _release(path, taken)


def _take(path: Path) -> int | Owner:
    """Take a claim: its file, which is open; or its owner if that is another process."""
    path.parent.mkdir(parents=True, exist_ok=True)
    while True:
        try:
            # Only one of several processes makes the file, also where there are no locks.
            flags = os.O_RDWR | os.O_CREAT | os.O_EXCL
            handle, is_new = patiently(os.open, path, flags, 0o666), True
        except FileExistsError:
            try:
                handle, is_new = os.open(path, os.O_RDWR), False
            except FileNotFoundError:
                continue
        locked = _lock_new(handle) if is_new else lock(handle)
        if locked is False:
            return _closed(handle, _read(handle) or UNKNOWN)
        # Its owner may just have removed it.
        if os.fstat(handle).st_nlink:
            break
        os.close(handle)
    if not is_new and (owner := _living(handle, locked, path.parent)) is not None:
        return _closed(handle, owner)
    try:
        os.ftruncate(handle, 0)
        os.lseek(handle, 0, os.SEEK_SET)
        os.write(handle, json.dumps(dataclasses.asdict(_this_process())).encode())
    except OSError:
        os.close(handle)
        remove(path)
        raise
    return handle


def _closed(handle: int, owner: Owner) -> Owner:
    """The owner of a claim, whose file is closed: Windows does not remove files that are open."""
    os.close(handle)
    return owner


def _lock_new(handle: int) -> bool | None:
    """As `lock`, of a file that this process made; another one may look at it, for a moment."""
    end = time.monotonic() + _LOOK_SECONDS
    while (locked := lock(handle)) is False and time.monotonic() < end:
        time.sleep(0.01)
    return locked


def _living(handle: int, locked: bool | None, folder: Path) -> Owner | None:
    """The owner of a claim that is not locked by another process; None if it is abandoned."""
    owner = _read(handle)
    if (
        owner is not None
        and owner.host == socket.gethostname()
        and (locked or not is_running(owner.process))
    ):
        return None
    with tempfile.NamedTemporaryFile(dir=folder) as file:
        # The clock of the file system, which may be another machine's.
        file.write(b"0")
        file.flush()
        now = os.fstat(file.fileno()).st_mtime
    # A process that has made a claim writes into it at once, unless it is killed.
    limit = _LOOK_SECONDS if owner is None else _ABANDONED_SECONDS
    is_abandoned = now - os.fstat(handle).st_mtime > limit
    return None if is_abandoned else owner or UNKNOWN


def _this_process() -> Owner:
    return Owner(socket.gethostname(), os.getpid(), round(time.time(), 1))


def _read(handle: int) -> Owner | None:
    """Content of a claim; None if its owner has not written it yet, or it is damaged."""
    os.lseek(handle, 0, os.SEEK_SET)
    try:
        record = Record(parse_json(os.read(handle, _MAX_CLAIM_BYTES)), "claim")
        return Owner(record.label("host"), record.integer("process"), record.number("since"))
    except LumitreeError:
        return None


@contextlib.contextmanager
def _renewed(path: Path) -> Iterator[None]:
    """Context in which the time of a claim is renewed."""
    ended = threading.Event()

    def renew() -> None:
        while not ended.wait(_RENEW_SECONDS):
            with contextlib.suppress(OSError):
                os.utime(path)

    thread = threading.Thread(target=renew, daemon=True, name="renew claim")
    thread.start()
    try:
        yield
    finally:
        ended.set()
        thread.join()


def _release(path: Path, handle: int) -> None:
    owner, this = _read(handle), _this_process()
    try:
        # While it is locked, so that it is not a claim of another process.
        if owner is not None and (owner.host, owner.process) == (this.host, this.process):
            path.unlink(missing_ok=True)
    except PermissionError:
        # On Windows it is removed when it is closed. If it stays, it names no owner.
        os.ftruncate(handle, 0)
        os.close(handle)
        with contextlib.suppress(PermissionError):
            remove(path)
    else:
        os.close(handle)
