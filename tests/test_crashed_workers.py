"""A crash of the compiler is not a failed test, unless it repeats."""

import subprocess
import sys
from pathlib import Path

import pytest

TEST = """
import os, pathlib

def test_before(): pass

def test_crash():
    crashes = pathlib.Path("crashes")
    with crashes.open("a") as file:
        file.write("x")
    if crashes.stat().st_size <= {times}:
        os.abort()

def test_after(): pass
"""


@pytest.mark.parametrize("times", [1, 9])
def test_a_crashed_test_is_run_once_more(tmp_path, times):
    (tmp_path / "test_it.py").write_text(TEST.format(times=times))
    (tmp_path / "pytest.ini").write_text(f"[pytest]\npythonpath = {Path(__file__).parent}\n")
    command = [sys.executable, "-m", "pytest", "-p", "crashed_workers", "-n", "1"]
    ended = subprocess.run(
        [*command, "--dist", "worksteal", "-p", "no:cacheprovider"],
        cwd=tmp_path,
        capture_output=True,
        text=True,
    )
    assert ended.returncode == (times > 1), ended.stdout + ended.stderr
    assert (tmp_path / "crashes").read_text() == "x" * min(times + 1, 2)
    expected = {1: "3 passed, 1 rerun", 9: "1 failed, 2 passed, 1 rerun"}[times]
    assert expected in ended.stdout
