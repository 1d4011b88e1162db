"""How a process is known to be the command line."""

import shlex
import subprocess
import sys

import pytest

from lumitree.core.program import is_program


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
        "from lumitree.core.program import open_streams\n"
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
