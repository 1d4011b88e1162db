"""What lumitree needs of its surroundings: modules, encodings, a home, folders for temporary files.

The rules of Windows are those of `support.windows_rules`; nothing here runs on Windows or macOS.
"""

import ast
import functools
import os
import subprocess
import sys
from pathlib import Path

import pytest

import lumitree
from support.exported_lamps import lamp
from support.windows_rules import run_by_windows_rules

TESTS = Path(__file__).parent
SOURCE = TESTS.parent / "src" / "lumitree"
MODULES = sorted(SOURCE.rglob("*.py"))
POSIX_MODULES = {"fcntl", "grp", "posix", "pty", "pwd", "resource", "termios", "tty"}
POSIX_NAMES = {
    *("SIGALRM", "SIGHUP", "SIGKILL", "SIGUSR1", "alarm", "chown", "fork", "forkpty", "getuid"),
    *("geteuid", "killpg", "mkfifo", "pathconf", "pause", "sched_getaffinity", "setitimer"),
    *("setsid", "statvfs", "symlink", "sync", "sysconf", "uname", "wait", "waitpid", "WNOHANG"),
}
TEXT_METHODS = {"read_text": 1, "write_text": 2}


@functools.cache
def nodes_of(path):
    return list(ast.walk(ast.parse(path.read_text(encoding="utf-8"))))


def imported(node):
    if isinstance(node, ast.Import):
        return {alias.name.split(".")[0] for alias in node.names}
    if isinstance(node, ast.ImportFrom) and node.module and not node.level:
        return {node.module.split(".")[0]}
    return set()


def test_one_module_alone_uses_what_posix_alone_has():
    """`core.system`, which has what takes their place."""
    users = set()
    for path in MODULES:
        for node in nodes_of(path):
            of_module = isinstance(node, ast.Attribute) and isinstance(node.value, ast.Name)
            used = of_module and node.value.id in ("os", "signal") and node.attr in POSIX_NAMES
            if used or imported(node) & POSIX_MODULES:
                users.add(path.relative_to(SOURCE).as_posix())
    assert users == {"core/system.py"}


def test_no_processes_are_forked():
    """Dr.Jit and JAX have threads, of which a forked process has none: one module spawns."""
    users = {
        path.relative_to(SOURCE).as_posix()
        for path in MODULES
        for node in nodes_of(path)
        if "multiprocessing" in imported(node)
        or (isinstance(node, ast.Name) and node.id == "ProcessPoolExecutor")
    }
    assert users == {"core/process_pool.py"}
    assert "SpawnContext" in (SOURCE / "core" / "process_pool.py").read_text("utf-8")


def has_encoding(node):
    """Whether a call that opens a file states an encoding or bytes; None for other calls."""
    function, name = node.func, ast.unparse(node.func).split(".")[-1]
    if name in TEXT_METHODS and isinstance(function, ast.Attribute):
        known = len(node.args) >= TEXT_METHODS[name]
    elif name == "open" and isinstance(function, ast.Name):
        known = len(node.args) > 1 and "b" in ast.unparse(node.args[1])
    elif name == "open" and node.args:
        mode = node.args[0]
        known = not (isinstance(mode, ast.Constant) and mode.value in ("r", "w", "a", "x"))
    else:
        return None
    return known or any(each.arg == "encoding" for each in node.keywords)


def test_text_files_have_an_encoding():
    """And not that of the system: cp1252 on Windows, ASCII in the C locale."""
    calls = [
        (f"{path.name}:{node.lineno}", has_encoding(node))
        for path in MODULES
        for node in nodes_of(path)
        if isinstance(node, ast.Call)
    ]
    assert [place for place, known in calls if known is False] == []
    assert sum(known is True for _, known in calls) > 20


def run(arguments, folder, **changes):
    """A command in a process of its own; `changes` of its environment: None removes a variable."""
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join(sys.path), **changes}
    return subprocess.run(
        [sys.executable, "-m", "lumitree", *arguments],
        cwd=folder,
        env={name: value for name, value in environment.items() if value is not None},
        capture_output=True,
        timeout=300,
    )


LAMP = (
    '<scene version="3.0.0"><shape type="sphere"><emitter type="area">'
    '<rgb name="radiance" value="3,2,1"/></emitter></shape></scene>'
)
C_LOCALE = {"LC_ALL": "C", "PYTHONUTF8": "0", "PYTHONIOENCODING": None}


@pytest.mark.skipif(os.name == "nt", reason="it has no C locale")
@pytest.mark.parametrize(
    "arguments", [["--help"], ["render", "--help"], ["list"], ["info", "lamp.lumitree"]]
)
def test_output_in_the_c_locale(tmp_path, arguments):
    """Characters that ASCII lacks become question marks."""
    lumitree.save(lamp("Größe ±"), tmp_path / "lamp.lumitree")
    result = run(arguments, tmp_path, **C_LOCALE)
    assert result.returncode == 0, result.stderr.decode()
    assert result.stdout.isascii()
    assert result.stderr == b""


def test_the_rules_of_the_c_locale_hold_in_these_tests(tmp_path):
    """Otherwise the tests with it would say nothing."""
    code = "import sys; print(sys.stdout.encoding, sys.flags.utf8_mode)"
    environment = {**os.environ, "LC_ALL": "C", "PYTHONUTF8": "0"}
    environment.pop("PYTHONIOENCODING", None)
    result = subprocess.run(
        [sys.executable, "-c", code], env=environment, capture_output=True, text=True
    )
    encoding, utf8 = result.stdout.split()
    assert encoding.lower() not in ("utf-8", "utf8")
    assert utf8 == "0"


COMMANDS = """
import dataclasses
import lumitree
from lumitree.cli import main
from support import tiny_bakes
from support.exported_lamps import lamp
from support.windows_rules import run_by_windows_rules

tiny_bakes.set_qualities(dict.__setitem__)
lumitree.save(lamp(), "other.lumitree")
for command in {commands!r}:
    for _ in range(2):
        # The second time over what the first one has written.
        assert main(command.split()) == 0, command
"""


@pytest.mark.slow
def test_commands_by_windows_rules(tmp_path):
    """Files are replaced while nothing holds them open, and folders are made in one step."""
    (tmp_path / "lamp.xml").write_text(LAMP, encoding="utf-8")
    commands = [
        "bake lamp.xml -o lamp.lumitree --parts all",
        "refine lamp.lumitree lamp.xml -o refined.lumitree --rays 300000 --irradiance-paths 16384",
        "bake lamp.xml -o lamps/ --parts light",
        "capture lamp.xml -o views --views 2 --resolution 16 --spp 4",
        "evaluate lamp.lumitree lamp.xml -o sheet.png --views 1 --resolution 16 --spp 4",
        "photometry lamp.lumitree -o lamp.ies -o lamp.pdf --step 30 --paths 65536",
        "photometry lamp.ies -o again.ies --step 30 --paths 65536",
        "export other.lumitree -o lamp.glb",
        "export other.lumitree -o lamp.rad",
        "view lamp.lumitree -o lamp.html",
    ]
    run_by_windows_rules(COMMANDS.format(commands=commands), tmp_path, timeout=900)
    assert not [path for path in tmp_path.rglob("*") if ".lumitree-" in path.name]


STOPPED_BAKE = """
import os, signal, threading, time
from pathlib import Path
from lumitree.cli import main
from support import tiny_bakes

def stop():
    while not Path("lamp.work").is_dir():
        time.sleep(0.1)
    os.kill(os.getpid(), signal.SIGBREAK)

# More rays than a day would be enough for.
tiny_bakes.set_qualities(dict.__setitem__, rays=1 << 40)
threading.Thread(target=stop, daemon=True).start()
assert main("bake lamp.xml -o lamp.lumitree --parts field".split()) == 128 + signal.SIGBREAK
"""


@pytest.mark.slow
def test_a_bake_is_stopped_by_windows_rules(tmp_path):
    (tmp_path / "lamp.xml").write_text(LAMP, encoding="utf-8")
    result = run_by_windows_rules(STOPPED_BAKE, tmp_path, timeout=600)
    assert "interrupted" in result.stderr
    assert not [path for path in tmp_path.rglob("*") if ".lumitree-" in path.name]
