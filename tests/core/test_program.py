"""How a process is known to be the command line."""

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
