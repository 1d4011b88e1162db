"""Rules of Windows that its tests on other systems need; `apply` comes before lumitree is imported.

What only POSIX systems have is missing. Files that are open are neither renamed nor removed,
folders are not opened, and no folder is renamed to one that exists. This is not Windows: paths,
consoles and libraries remain those of the system.
"""

import os
import shutil
import signal
import subprocess
import sys
import textwrap
from pathlib import Path

try:
    import fcntl  # before it is taken away
except ImportError:
    fcntl = None

TESTS = Path(__file__).parents[1]
# Where the system lists the open files of a process: Linux, or macOS.
DESCRIPTORS = "/proc/self/fd" if os.path.isdir("/proc/self/fd") else "/dev/fd"
MODULES = ("fcntl", "grp", "pwd", "resource", "termios")
SIGNALS = ("SIGALRM", "SIGHUP", "alarm", "setitimer", "pthread_kill")
FUNCTIONS = ("pathconf", "pread", "pwrite", "statvfs", "sync")


def apply():
    hide()
    for name in FUNCTIONS:
        delattr(os, name)
    # With descriptors, which Windows has not for folders.
    shutil._use_fd_functions = False  # pyright: ignore[reportAttributeAccessIssue]
    for name in ("remove", "rename", "replace", "unlink"):
        setattr(os, name, _only_closed(getattr(os, name)))
    os.open = _only_files(os.open)


def hide():
    """Take away modules and signals alone: `multiprocessing` needs the rest of the system."""
    for name in MODULES:
        sys.modules[name] = None  # pyright: ignore[reportArgumentType]
    for name in SIGNALS:
        delattr(signal, name)
    # A signal that the tests can send in its place.
    signal.SIGBREAK = signal.SIGUSR1  # pyright: ignore[reportAttributeAccessIssue]


def _open_files():
    found = set()
    for descriptor in os.listdir(DESCRIPTORS):
        try:
            found.add(os.path.realpath(_name(descriptor)))
        except OSError:
            continue
    return found


def _name(descriptor):
    """Path of an open file."""
    if DESCRIPTORS == "/proc/self/fd":
        return os.readlink(f"{DESCRIPTORS}/{descriptor}")
    return fcntl.fcntl(int(descriptor), fcntl.F_GETPATH, bytes(1024)).rstrip(b"\0").decode()


def _only_closed(function):
    def run(*paths, **options):
        for path in map(os.path.realpath, paths):
            within = os.path.join(path, "")
            if any(each == path or each.startswith(within) for each in _open_files()):
                raise PermissionError(13, "it is used by this process", path)
        if len(paths) == 2 and all(map(os.path.isdir, paths)):
            raise PermissionError(13, "the folder exists", paths[1])
        return function(*paths, **options)

    return run


def _only_files(function):
    def run(path, *arguments, **options):
        if os.path.isdir(path):
            raise PermissionError(13, "it is a folder", path)
        return function(path, *arguments, **options)

    return run


def run_by_windows_rules(code, folder, timeout=60):
    """Output of a program that has what Windows has; it must end with status 0."""
    program = "from support.windows_rules import apply\napply()\n" + textwrap.dedent(code)
    return _run(["-c", program], folder, [], timeout)


def run_script_without_posix(code, folder, timeout=60):
    """Output of a script that has what `hide` leaves, and so have the processes that it starts."""
    site = folder / "site"
    site.mkdir()
    # Python imports this module first of all.
    (site / "sitecustomize.py").write_text("from support.windows_rules import hide\nhide()\n")
    script = folder / "script.py"
    script.write_text(textwrap.dedent(code))
    return _run([str(script)], folder, [str(site)], timeout)


def _run(arguments, folder, first, timeout):
    result = subprocess.run(
        [sys.executable, *arguments],
        cwd=folder,
        env={**os.environ, "PYTHONPATH": os.pathsep.join([*first, str(TESTS), *sys.path])},
        capture_output=True,
        text=True,
        timeout=timeout,
    )
    assert result.returncode == 0, result.stderr
    return result
