"""The benchmark `gpu`: its statistics, its processes, results of tests, and its page."""

import dataclasses
import json
import sys
import time
from pathlib import Path

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.gpu_parts import running, suite
from benchmarks.gpu_parts.comparisons import agreement
from benchmarks.gpu_parts.page import page
from benchmarks.gpu_parts.part import Context, Part
from benchmarks.gpu_parts.parts import all_parts
from benchmarks.gpu_parts.running import Run, run_parts
from benchmarks.gpu_parts.sizes import SIZES
from support.slow import slow

ROOT = Path(__file__).parents[2]


def batches(seed, factor=1.0, count=16):
    """Noisy estimates of 200 known numbers."""
    true = np.random.default_rng(0).uniform(1, 2, (20, 10))
    noise = np.random.default_rng([1, seed]).normal(0, 0.2, (count, 20, 10))
    return factor * (true + noise)


def test_by_chance_few_agreements_are_missed():
    """p is uniform if both estimate the same."""
    found = [agreement(batches(3 * i), batches(3 * i + 1, count=12))["p"] for i in range(1, 101)]
    assert 25 < sum(p < 0.5 for p in found) < 75


def test_a_common_difference_that_the_noise_of_each_hides_is_found_with_its_ratio():
    found = agreement(batches(1, 1.05), batches(2))
    assert not found["agrees"]
    assert found["ratio"] == pytest.approx(1.05, abs=4 * found["ratio_error"])


def test_nothing_agrees_with_values_that_are_not_finite():
    first = batches(1)
    first[2, 3, 4] = np.nan
    found = agreement(first, batches(2))
    assert not found["agrees"]
    # The value, and the sum of its batch.
    assert found["not_finite"] == 2


def test_tests_of_a_gpu_exist():
    for paths in SIZES["gpu"].tests.values():
        assert all((ROOT / path).exists() for path in paths)


PROLOGUE = """
import json, os, signal, sys, time
job = json.load(open(sys.argv[1]))
def report(values, outcome=None, reason=""):
    text = json.dumps({"values": values, "outcome": outcome, "reason": reason})
    open(job["state"] + ".new", "w").write(text)
    os.replace(job["state"] + ".new", job["state"])
"""


@pytest.fixture
def run(tmp_path):
    return Run("tiny", "llvm_ad_rgb", tmp_path / "gpu", tmp_path / "gpu.work", "command")


def part(name="a", seconds=60.0):
    return Part(name, "A part", seconds, lambda context: {}, str)


@pytest.mark.parametrize(
    ("code", "seconds", "outcome", "reason"),
    [
        ('report({"x": 1}, "done")', 60.0, "done", ""),
        slow('report({"x": 1}, "done"); time.sleep(600)', 60.0, "done", ""),
        ('report({"x": 1}); os.kill(os.getpid(), 11)', 60.0, "failed", "by SIGSEGV"),
        ('report({"x": 1}); print("no memory"); exit(3)', 60.0, "failed", "exit status 3: no mem"),
        slow('report({"x": 1}); time.sleep(600)', 60.0, "unfinished", ""),
    ],
)
def test_what_a_part_leaves(run, monkeypatch, code, seconds, outcome, reason):
    monkeypatch.setattr(running, "_TO_END", 0.3)
    given = 3.0 if outcome == "unfinished" else seconds
    command = [sys.executable, "-c", PROLOGUE + code]
    assert run.measure(part(seconds=seconds), given, command) == outcome
    record = run.record(part())
    assert (record["outcome"], record["values"]) == (outcome, {"x": 1})
    assert record["reason"].startswith(reason)
    for key in ("commit", "device", "accelerator", "driver", "variant", "mitsuba", "command"):
        assert record["setting"][key]


def test_what_is_due(run):
    parts = [part(name) for name in "abcd"]
    called = []

    def measure(each, seconds):
        called.append(each.name)
        outcome = {"b": "failed", "c": "unfinished", "d": "skipped"}.get(each.name, "done")
        run.folder.mkdir(exist_ok=True)
        (run.folder / f"{each.name}.json").write_text(json.dumps({"outcome": outcome}))
        return outcome

    run.measure = measure
    for again, expected in ((False, "abcd"), (False, "c"), (True, "bc")):
        called.clear()
        run_parts(parts, run, 60, again)
        assert "".join(called) == expected
    run_parts([part("e")], run, 0)
    assert "e" not in called


def context_of(tmp_path):
    sizes = dataclasses.replace(SIZES["tiny"], test_seconds=5.0)
    (tmp_path / "work").mkdir()
    state = tmp_path / "state.json"
    folders = tmp_path / "work", tmp_path / "gpu"
    return Context(sizes, "llvm_ad_rgb", *folders, state, time.time() + 600)


TESTS = """
import os, time
import pytest

def test_good():
    pass

def test_bad():
    assert 1 == 2, "one is not two"

def test_crash():
    os.abort()

@pytest.mark.skip(reason="not here")
def test_skipped():
    pass

def test_hang():
    time.sleep(600)

def test_last():
    pass
"""


@pytest.mark.slow
def test_every_test_has_a_result(tmp_path, monkeypatch):
    monkeypatch.setattr(suite, "ROOT", tmp_path)
    monkeypatch.setenv("PYTHONPATH", f"{ROOT}:{ROOT / 'src'}")
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    (tmp_path / "some").mkdir()
    (tmp_path / "some" / "test_some.py").write_text(TESTS)
    (tmp_path / "some" / "test_broken.py").write_text("import nothing_of_this_name\n")
    context = context_of(tmp_path)
    values = suite.run_tests(context, ["some"])
    counts = {"passed": 2, "skipped": 1, "failed": 2, "timed out": 1, "crashed": 1}
    assert values["counts"] == counts
    failures = {each["test"].rpartition(":")[2]: each for each in values["failures"]}
    assert "one is not two" in failures["test_bad"]["message"]
    assert failures["test_crash"]["message"] == "SIGABRT"
    assert failures["test_hang"]["message"] == "more than 5 s"
    assert "nothing_of_this_name" in failures["some/test_broken.py"]["message"]
    # Nothing is run twice.
    assert suite.run_tests(context, ["some"])["counts"] == counts
    assert "2 passed" in suite.show(values)


def test_a_trial_says_that_it_is_none_of_a_gpu():
    parts = all_parts(SIZES["tiny"])
    facts = {"command": "c", "commit": "1", "accelerator": "none", "variant": "llvm_ad_rgb"}
    record = {"outcome": "done", "reason": "", "seconds": 1.0, "setting": facts, "size": "tiny"}
    images = {
        "bulbs": agreement(batches(1, 1.05), batches(2)),
        "star": agreement(np.full((4, 2), np.inf), batches(2)[:4, 0, :2]),
    }
    records = {"images": {**record, "values": images}, "network": {**record, "values": {"x": 1}}}
    text = page(parts, records)
    assert "These are not figures of a GPU" in text
    assert "| bulbs | **differs** | 201 |" in text
    assert "| star | **differs** | 3 | 12 values are not finite |" in text
    assert "| irradiance | not measured yet |" in text
    assert "The values in network.json cannot be shown" in text
    device = {**facts, "variant": "cuda_ad_rgb", "accelerator": "NVIDIA H200"}
    shown = page(parts, {"images": {**records["images"], "setting": device, "size": "gpu"}})
    assert shown.startswith("# On a GPU\n\nMeasured on NVIDIA H200")


@pytest.mark.slow
def test_all_parts_on_the_cpu(network_packages, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert main(["gpu", "--dry-run", "--minutes", "60", "--work", str(tmp_path / "work")]) == 0
    records = tmp_path / "work" / "gpu-trial"
    found = {path.stem: json.loads(path.read_text()) for path in records.glob("*.json")}
    assert set(found) == {each.name for each in all_parts(SIZES["tiny"])}
    assert {name: each["reason"] for name, each in found.items() if each["outcome"] != "done"} == {}
    assert "cannot be shown" not in (tmp_path / "work" / "gpu-trial.md").read_text()
