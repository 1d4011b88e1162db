"""The benchmark `gpu`: its statistics, its processes, results of tests, and all parts on a CPU."""

import dataclasses
import fcntl
import json
import sys
import time
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.common import setting
from benchmarks.gpu_parts import __main__ as process
from benchmarks.gpu_parts import running, suite
from benchmarks.gpu_parts.agreement import agreement
from benchmarks.gpu_parts.page import page
from benchmarks.gpu_parts.part import Context, Part, SkippedError, UnfinishedError, tables_of
from benchmarks.gpu_parts.parts import all_parts
from benchmarks.gpu_parts.peaks import PEAKS, peak_of
from benchmarks.gpu_parts.running import Run, run_parts
from benchmarks.gpu_parts.sizes import SIZE_NAMES, SIZES
from benchmarks.paper_tables.work import plain

ROOT = Path(__file__).parents[2]


def batches(seed, factor=1.0, count=16):
    """Noisy estimates of 200 known numbers."""
    true = np.random.default_rng(0).uniform(1, 2, (20, 10))
    noise = np.random.default_rng([1, seed]).normal(0, 0.2, (count, 20, 10))
    return factor * (true + noise)


def test_estimates_of_the_same_agree():
    found = agreement(batches(1), batches(2, count=12))
    assert found["agrees"]
    assert found["quantities"] == 201
    assert abs(found["ratio"] - 1) < 4 * found["ratio_error"]
    # Of 200 quantities one is two standard errors away, and that is no difference.
    assert found["largest_z"] > 2


def test_by_chance_few_agreements_are_missed():
    """p is uniform if both estimate the same."""
    found = [agreement(batches(3 * i), batches(3 * i + 1))["p"] for i in range(1, 101)]
    assert 25 < sum(p < 0.5 for p in found) < 75


def test_a_common_difference_that_the_noise_of_each_hides_is_found_with_its_ratio():
    found = agreement(batches(1, 1.05), batches(2))
    assert not found["agrees"]
    assert found["ratio"] == pytest.approx(1.05, abs=4 * found["ratio_error"])


def test_one_quantity_that_differs_is_found():
    first = batches(1)
    first[:, 3, 4] += 1
    assert not agreement(first, batches(2))["agrees"]


def test_quantities_without_noise_agree_if_they_are_equal():
    first, second = batches(1), batches(2)
    first[:, 0], second[:, 0] = 0, 0
    assert agreement(first, second)["agrees"]
    first[:, 0, 0] = 0.1
    assert agreement(first, second)["p"] < 1e-100


def test_nothing_agrees_with_values_that_are_not_finite():
    first = batches(1)
    first[2, 3, 4] = np.nan
    found = agreement(first, batches(2))
    assert not found["agrees"]
    # The value, and the sum of its batch.
    assert found["not_finite"] == 2
    assert json.loads(json.dumps(found)) == found


def test_peaks_are_found_by_the_name_of_the_driver():
    assert peak_of("NVIDIA H100 80GB HBM3").tf32 == 494.7
    assert peak_of("NVIDIA H100 PCIe").tf32 == 378
    assert peak_of("none") is None
    for index, peak in enumerate(PEAKS):
        assert not any(peak.name.startswith(other.name) for other in PEAKS[:index])


def test_tables_of_a_page():
    text = "# A\n\n| a |\n|---|\n| 1 |\n\nText\n| b |\n|---|"
    assert tables_of(text) == ["| a |\n|---|\n| 1 |\n", "| b |\n|---|\n"]


@pytest.mark.parametrize("size", SIZE_NAMES)
def test_parts_have_names_of_their_own_and_parameters_that_json_holds(size):
    parts = all_parts(SIZES[size])
    assert len({part.name for part in parts}) == len(parts)
    for part in parts:
        assert 0 < part.least < part.seconds
        assert json.loads(json.dumps(plain(part.parameters))) == plain(part.parameters)


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
def run(tmp_path, monkeypatch):
    # Other work may share the cores.
    monkeypatch.setattr(running, "_TO_END", 120.0)
    return Run("tiny", "llvm_ad_rgb", tmp_path / "gpu", tmp_path / "gpu.work", "command")


def part(name="a", seconds=60.0, parameters=None):
    return Part(name, "A part", seconds, 0.1, lambda context: {}, parameters or {})


def measured(run, code, seconds=60.0, given=60.0):
    """Record of a part whose process runs some code."""
    each = part(seconds=seconds)
    outcome = run.measure(each, given, [sys.executable, "-c", PROLOGUE + code])
    record = run.record(each)
    assert record["outcome"] == outcome
    assert not list(run.work.glob("*.json"))
    return record


def test_a_part_leaves_its_values_and_where_it_ran(run):
    record = measured(run, 'report({"x": 1}, "done"); print("said")')
    assert (record["outcome"], record["values"]) == ("done", {"x": 1})
    assert record["end_of_process"] == "by itself"
    assert record["peak_memory_bytes"] > 1e6
    assert record["seconds"] >= 0
    for key in ("commit", "device", "accelerator", "driver", "variant", "mitsuba", "command"):
        assert record["setting"][key]
    assert (run.work / "logs" / "a.log").read_text() == "said\n"


def test_a_part_that_hangs_at_its_end_is_done(run, monkeypatch):
    monkeypatch.setattr(running, "_TO_END", 0.3)
    record = measured(run, 'report({"x": 1}, "done"); time.sleep(600)')
    assert (record["outcome"], record["values"]) == ("done", {"x": 1})
    assert record["end_of_process"] == "killed at its end"


def test_a_crash_costs_its_part_only(run):
    code = 'report({"x": 1}); print("no memory", flush=True); os.kill(os.getpid(), signal.SIGSEGV)'
    record = measured(run, code)
    assert (record["outcome"], record["values"]) == ("failed", {"x": 1})
    assert record["reason"].startswith("by SIGSEGV: ")
    assert "no memory" in (run.work / "logs" / "a.log").read_text()


def test_a_part_that_takes_too_long_is_killed_with_what_it_started(run, tmp_path):
    held = tmp_path / "held"
    child = (
        f"import fcntl, time; file = open({str(held)!r}, 'w'); fcntl.flock(file, fcntl.LOCK_EX); "
        "time.sleep(600)"
    )
    code = f'import subprocess; subprocess.Popen([sys.executable, "-c", {child!r}])\n'
    wait = f"while not os.path.exists({str(held)!r}): time.sleep(0.01)\n"
    record = measured(run, code + wait + 'report({"x": 1}); time.sleep(600)', 6.0, 6.0)
    assert (record["outcome"], record["values"]) == ("timed out", {"x": 1})
    # Where it was when it ended, by Python's fault handler.
    assert "most recent call first" in (run.work / "logs" / "a.log").read_text()
    # The lock of a process ends with it.
    with held.open() as file:
        for _ in range(600):
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                break
            except BlockingIOError:
                time.sleep(0.1)
        else:
            pytest.fail("what the part started still runs")


def test_a_part_that_had_too_little_time_is_not_finished(run):
    assert measured(run, "time.sleep(600)", 60.0, 0.5)["outcome"] == "unfinished"


def test_what_is_due(run, capsys):
    parts = [part("a"), part("b"), part("c"), part("d"), part("e", parameters={"p": (1, 2)})]
    called = []

    def measure(each, seconds):
        called.append(each.name)
        outcome = {"b": "failed", "c": "unfinished", "d": "skipped"}.get(each.name, "done")
        parameters = run._parameters(each)
        record = {"outcome": outcome, "parameters": parameters}
        run.folder.mkdir(exist_ok=True)
        run.path(each).write_text(json.dumps(record))
        return outcome

    run.measure = measure
    run_parts(parts, run, 60)
    assert called == ["a", "b", "c", "d", "e"]
    called.clear()
    run_parts(parts, run, 60)
    assert called == ["c"]
    called.clear()
    run_parts(parts, run, 60, again=True)
    assert called == ["b", "c"]
    called.clear()
    # Other parameters are another part; and without time nothing is begun.
    run_parts([part("e", parameters={"p": (1, 3)})], run, 0)
    assert called == []
    assert "e: 0 s are left" in capsys.readouterr().err
    run_parts([part("e", parameters={"p": (1, 3)})], run, 60)
    assert called == ["e"]


@pytest.mark.parametrize(
    ("ends", "outcome", "values"),
    [
        (None, "done", {"x": 2}),
        (UnfinishedError("later"), "unfinished", {"x": 1}),
        (SkippedError("no JAX"), "skipped", {}),
    ],
)
def test_what_the_process_of_a_part_leaves(tmp_path, monkeypatch, ends, outcome, values):
    def measure(context):
        context.report({"x": 1, "unknown": float("nan")} if ends is None else {"x": 1})
        if ends is not None:
            raise ends
        return {"x": 2}

    each = dataclasses.replace(part(), measure=measure)
    monkeypatch.setattr(process, "all_parts", lambda sizes: [each])
    job = {"part": "a", "size": "tiny", "variant": "llvm_ad_rgb", "end": 0.0}
    job |= {name: str(tmp_path / name) for name in ("work", "folder", "state")}
    (tmp_path / "job.json").write_text(json.dumps(job))
    process.main(tmp_path / "job.json")
    left = json.loads((tmp_path / "state").read_text())
    assert left == {"outcome": outcome, "values": values, "reason": str(ends or "")}


def test_the_network_is_skipped_where_jax_has_no_gpu(tmp_path, monkeypatch):
    monkeypatch.setitem(sys.modules, "jax", SimpleNamespace(default_backend=lambda: "cpu"))
    context = context_of(tmp_path)
    context.check_jax()
    with pytest.raises(SkippedError, match="JAX has no GPU"):
        dataclasses.replace(context, variant="cuda_ad_rgb").check_jax()
    monkeypatch.setitem(sys.modules, "jax", None)
    with pytest.raises(SkippedError, match="the network needs JAX"):
        context.check_jax()


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


def context_of(tmp_path, seconds=600.0):
    sizes = dataclasses.replace(
        SIZES["tiny"], tests={"kernels": ("some",), "more": ("more",)}, test_seconds=5.0
    )
    end = time.time() + seconds
    state = tmp_path / "state.json"
    return Context(sizes, "llvm_ad_rgb", tmp_path / "work", tmp_path / "gpu", state, end)


@pytest.fixture
def tests_of_their_own(tmp_path, monkeypatch):
    monkeypatch.setattr(suite, "ROOT", tmp_path)
    monkeypatch.setenv("PYTHONPATH", str(ROOT))
    (tmp_path / "pytest.ini").write_text("[pytest]\n")
    for name in ("some", "more"):
        (tmp_path / name).mkdir()
    (tmp_path / "some" / "test_some.py").write_text(TESTS)
    (tmp_path / "some" / "test_broken.py").write_text("import nothing_of_this_name\n")
    hangs = "import atexit, time\natexit.register(time.sleep, 600)\n\ndef test_more():\n    pass\n"
    (tmp_path / "more" / "test_more.py").write_text(hangs)
    return context_of(tmp_path)


@pytest.mark.slow
def test_every_test_has_a_result(tests_of_their_own, monkeypatch):
    context = tests_of_their_own
    monkeypatch.setattr(suite, "_TO_END", 120.0)
    values = suite.run_tests(context, "kernels")
    assert values["counts"] == {
        "passed": 2,
        "skipped": 1,
        "failed": 2,
        "timed out": 1,
        "crashed": 1,
    }
    failures = {each["test"].rpartition(":")[2]: each for each in values["failures"]}
    assert "one is not two" in failures["test_bad"]["message"]
    assert failures["test_crash"]["message"] == "SIGABRT"
    assert failures["test_hang"]["message"] == "more than 5 s"
    assert "nothing_of_this_name" in failures["some/test_broken.py"]["message"]
    assert values["ends"] == [
        "crashed in some/test_some.py::test_crash",
        "timed out in some/test_some.py::test_hang",
        "finished",
    ]
    assert json.loads(context.state.read_text())["values"] == values
    # Nothing is run twice.
    again = suite.run_tests(context, "kernels")
    assert (again["counts"], again["ends"]) == (values["counts"], ["finished"])
    assert list((context.work / "tests").glob("kernels-*.xml"))
    # After its last test pytest does not end.
    monkeypatch.setattr(suite, "_TO_END", 0.5)
    more = suite.run_tests(context, "more")
    assert more["ends"] == ["finished, and then hung for more than 0.5 s"]
    assert more["counts"]["passed"] == 1


def test_tests_go_on_where_the_time_was_spent(tests_of_their_own, tmp_path):
    with pytest.raises(suite.UnfinishedError):
        suite.run_tests(context_of(tmp_path, seconds=1.0), "more")


def test_a_trial_says_that_it_is_none_of_a_gpu():
    parts = all_parts(SIZES["tiny"])
    facts = {"command": "c", "commit": "1", "accelerator": "none", "variant": "llvm_ad_rgb"}
    record = {
        "outcome": "done",
        "reason": "",
        "end_of_process": "by itself",
        "seconds": 1.0,
        "peak_memory_bytes": 2e9,
        "peak_gpu_bytes": 0,
        "setting": facts,
        "parameters": {"size": "tiny"},
        "values": {
            "bulbs": agreement(batches(1, 1.05), batches(2)),
            "star": agreement(np.full((4, 2), np.inf), batches(2)[:4, 0, :2]),
        },
    }
    text = page(parts, {"images": record})
    assert "These are not figures of a GPU" in text
    assert "| bulbs | **differs** | 201 |" in text
    assert "| star | **differs** | 3 | 12 values are not finite |" in text
    assert "| training | not measured yet |" in text
    broken = {**record, "values": {"steps": None}}
    shown = page(parts, {"images": record, "training": broken})
    assert "The values in training.json cannot be shown" in shown
    assert "| bulbs | **differs** | 201 |" in shown
    device = {**facts, "variant": "cuda_ad_rgb", "accelerator": "NVIDIA H100 80GB HBM3"}
    measured = {"seconds": 0.01, "flops": 7e11, "flops_per_second": 6.7e13}
    measured["peak_flops_per_second"] = 3.5e14
    of_gpu = {**record, "setting": device, "parameters": {"size": "gpu"}}
    step = {**of_gpu, "values": {"command": "c", "values": {"of this scale": measured}}}
    text = page(all_parts(SIZES["gpu"]), {"images": of_gpu, "step": step})
    assert text.startswith("# On a GPU\n\nMeasured on NVIDIA H100 80GB HBM3")
    assert "not figures" not in text
    assert "| of this scale | 0.0100 | 700.0 | 67.00 | 350.00 | 19% | 13.5% | 100.0% |" in text


def test_the_commit_of_a_copy_without_history(monkeypatch):
    monkeypatch.setattr(setting, "git", lambda *command: "")
    monkeypatch.delenv("LUMITREE_COMMIT", raising=False)
    assert setting.commit() == "unknown"
    monkeypatch.setenv("LUMITREE_COMMIT", "1234abc")
    assert setting.commit() == "1234abc"


def test_git_may_be_missing(monkeypatch):
    monkeypatch.setenv("PATH", "/nowhere")
    assert setting.git("describe", "--always") == ""
    assert setting.nvidia("name") == []


@pytest.mark.parametrize(
    ("arguments", "message"),
    [
        (["--dry-run", "--part", "none"], "no parts none; expected devices, "),
        (["--variant", "llvm_ad_spectral"], "expected cuda_ad_rgb or llvm_ad_rgb"),
    ],
)
def test_bad_arguments_are_one_line(arguments, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(["gpu", *arguments, "-o", "out"]) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_all_parts_on_a_cpu(network_packages, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    argv = ["gpu", "--dry-run", "--minutes", "120", "-o", "out"]
    assert main(argv) == 0
    out, err = capsys.readouterr()
    assert "left: nothing" in out
    records = {
        path.stem: json.loads(path.read_text())
        for path in (tmp_path / "out" / "gpu-trial").glob("*.json")
    }
    parts = all_parts(SIZES["tiny"])
    for each in parts:
        record = records[each.name]
        assert record["outcome"] == "done", (each.name, record["reason"], err)
        assert record["values"]
    for name in ("images", "irradiance", "light-field"):
        assert all(each["agrees"] for each in records[name]["values"].values()), records[name]
    assert records["tests-kernels"]["values"]["counts"]["passed"] > 0
    assert records["training"]["values"]["steps"] == SIZES["tiny"].network.num_steps
    octrees = records["extraction"]["values"]["octrees"]
    assert octrees
    assert all(each["leaves"] > 0 for each in octrees)
    text = (tmp_path / "out" / "gpu-trial.md").read_text()
    assert "These are not figures of a GPU" in text
    assert all(f"\n## {each.title}\n" in text for each in parts)
    # Both were measured by one benchmark.
    assert len(records["devices"]["values"]["tables"]) == 1
    assert json.loads((tmp_path / "out/gpu-trial/benchmarks/devices.json").read_text())
    # The second call has nothing to do.
    assert main(argv) == 0
    assert capsys.readouterr().err == ""
