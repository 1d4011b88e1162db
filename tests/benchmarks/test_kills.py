"""Kills find what is wrong with commands that are made to be wrong; growth of memory."""

import shutil
import sys

import numpy as np
import pytest

from benchmarks.kills import table
from benchmarks.memory import growth
from benchmarks.reliability.comparison import equal, is_complete
from benchmarks.reliability.jobs import Job
from benchmarks.reliability.trial import Reference, Trial, Watched, measure, run_trial
from lumitree.core.images import write_exr

# Writes a file in parts, and renames it.
PROGRAM = """
import os, time
os.makedirs("out", exist_ok=True)
with open("out/.a.lumitree-12345678.txt", "w") as file:
    for part in range(5):
        file.write(f"part {part}\\n")
        file.flush()
        time.sleep(0.05)
os.replace("out/.a.lumitree-12345678.txt", "out/a.txt")
"""
TEXT = "".join(f"part {part}\n" for part in range(5))


@pytest.fixture
def inputs(tmp_path):
    folder = tmp_path / "inputs"
    folder.mkdir()
    (folder / "mine.txt").write_text("mine")
    return folder


def test_a_command_that_renames_has_no_faults(inputs, tmp_path):
    (tmp_path / "program.py").write_text(PROGRAM)
    job = Job("a", (), program=(sys.executable, str(tmp_path / "program.py")))
    reference = measure(job, inputs, tmp_path / "reference")
    assert reference.agreement == {"a.txt": "bytes"}
    found = run_trial(job, reference, inputs, tmp_path / "trial", "seed", 2)
    assert found["faults"] == []
    assert (tmp_path / "trial" / "out" / "a.txt").read_text() == TEXT
    report = {
        "references": {"a": {"seconds": 0.5, "agreement": ["bytes"]}},
        "trials": [{"job": "a", **found}],
    }
    (line,) = table(report).rows
    assert line[0] == "a"
    assert line[-2] == "by bytes"


@pytest.fixture
def checked(inputs, tmp_path):
    """A trial, as it is before a command has written anything."""
    reference = tmp_path / "reference"
    (reference / "out").mkdir(parents=True)
    (reference / "out" / "a.txt").write_text(TEXT)
    shutil.copytree(inputs, tmp_path / "trial")
    (tmp_path / "trial" / "out").mkdir()
    job = Job("a", (), program=("true",), state=("w/*",), kept=("k*",), done=_done)
    found = Reference(reference, 1.0, 1, 0.5, {"a.txt": "bytes", "k.txt": "bytes"})
    return Trial(job, found, inputs, tmp_path / "trial"), tmp_path / "trial"


def _done(out):
    return len(list(out.glob("w/*")))


def test_what_a_killed_command_may_leave_is_no_fault(checked):
    trial, folder = checked
    for name, text in (("a.txt", TEXT), (".a.lumitree-12345678.txt", "part"), ("w/state", "x")):
        (folder / "out" / name).parent.mkdir(exist_ok=True)
        (folder / "out" / name).write_text(text)
    trial.check_killed("bake: 50 %")
    assert trial.faults == []


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("out/a.txt", TEXT[:-3], "a.txt differs from that of an uninterrupted command"),
        ("out/b.txt", "", "b.txt is not a file of the output"),
        ("stderr", "Traceback (most recent call last):", "printed: Traceback"),
    ],
)
def test_faults_after_a_kill_are_found(checked, name, text, fault):
    trial, folder = checked
    (folder / name).write_text(text)
    trial.check_killed((folder / "stderr").read_text() if name == "stderr" else "")
    assert len(trial.faults) == 1
    assert fault in trial.faults[0]


def test_work_that_is_lost_is_found(checked):
    trial, folder = checked
    (folder / "out" / "w").mkdir()
    (folder / "out" / "w" / "1").touch()
    trial.check_killed("")
    (folder / "out" / "w" / "1").unlink()
    trial.check_killed("")
    assert trial.faults == ["1 were done, and then 0"]


@pytest.mark.parametrize(
    ("name", "text", "fault"),
    [
        ("out/a.txt", TEXT[:-3], "a.txt differs from that of an uninterrupted command"),
        ("out/b.txt", "", "other files at the end: ['b.txt']"),
        ("out/.a.lumitree-12345678.txt", "", "temporary files stay"),
        ("tmp/lumitree-scratch-12345678", "", "temporary files stay"),
        ("mine.txt", "other", "the input mine.txt was changed"),
    ],
)
def test_faults_at_the_end_are_found(checked, name, text, fault):
    trial, folder = checked
    (folder / "out" / "a.txt").write_text(TEXT)
    (folder / "tmp").mkdir()
    running = Watched(Job("a", (), program=("true",)), folder)
    trial.check_finished(running)
    assert trial.faults == []
    (folder / name).write_text(text)
    trial.check_finished(running)
    assert any(fault in line for line in trial.faults), trial.faults


def test_files_are_compared_by_their_content(tmp_path):
    a, b = tmp_path / "a.csv", tmp_path / "b.csv"
    a.write_text("x,1.0000,2\n")
    b.write_text("x,1.0001,2\n")
    assert equal(a, a) == "bytes"
    assert equal(a, b) == "values"
    for other in ("y,1.0,2\n", "x,1.01,2\n", "x,1.0,2,3\n", ""):
        b.write_text(other)
        assert equal(a, b) is None, other
    pixels = np.ones((2, 2, 3), np.float32)
    first, second = tmp_path / "a.exr", tmp_path / "b.exr"
    write_exr(first, {"RGB": pixels})
    write_exr(second, {"RGB": pixels * np.float32(1.0001)})
    assert equal(first, second) == "values"
    write_exr(second, {"RGB": pixels * np.float32(1.01)})
    assert equal(first, second) is None
    second.write_bytes(second.read_bytes()[:-8])
    assert equal(first, second) is None


def test_files_that_vary_must_be_complete(tmp_path):
    path = tmp_path / "a.json"
    for text, complete in (('{"a": 1}', True), ('{"a"', False), ("", False)):
        path.write_text(text)
        assert is_complete(path) == complete
    page = tmp_path / "a.html"
    page.write_text("<html></html>\n")
    assert is_complete(page)
    page.write_text("<html></ht")
    assert not is_complete(page)


def test_growth_is_that_after_the_warm_up():
    steps = np.arange(200.0)
    warm = np.minimum(steps, 30) * 100
    slope, _ = growth(warm + 0.5 * steps)
    assert slope == pytest.approx(0.5)
    noise = np.random.default_rng(0).normal(0, 3, len(steps))
    slope, error = growth(warm + noise)
    assert abs(slope) < 4 * error < 0.1
