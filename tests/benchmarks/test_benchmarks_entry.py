"""`python -m benchmarks`: its list, its errors, and one benchmark from end to end."""

import json
import subprocess
import sys
from pathlib import Path

import pytest

import lumitree
from benchmarks.__main__ import main, names
from benchmarks.common.setting import command_line
from support.fields import random_asset

ROOT = Path(__file__).parents[2]


def test_without_a_name_it_lists_all(capsys):
    assert main([]) == 0
    lines = capsys.readouterr().out.splitlines()[2:]
    assert [line.split()[0] for line in lines] == names()
    assert {"octree_fit", "equal_quality", "luminaires", "query", "sampling", "scaling"} <= set(
        names()
    )
    assert all(len(line.split()) > 5 for line in lines)


def test_the_module_runs_from_the_root():
    run = subprocess.run(
        [sys.executable, "-m", "benchmarks", "nonsense"], cwd=ROOT, capture_output=True, text=True
    )
    assert run.returncode == 2
    assert not run.stdout
    (line,) = run.stderr.splitlines()
    assert line.startswith("benchmarks: error: ")
    assert "nonsense" in line
    assert all(name in line for name in names())


@pytest.mark.parametrize("name", names())
def test_every_benchmark_explains_itself(name, capsys):
    with pytest.raises(SystemExit) as ended:
        main([name, "--help"])
    assert ended.value.code == 0
    text = capsys.readouterr().out
    assert "--output" in text
    assert "--variant" in text


@pytest.mark.parametrize(
    ("argv", "message"),
    [
        (["query"], "ASSET"),
        (["query", "none.lumitree"], "none.lumitree"),
        (["query", "none.lumitree", "--variant", "scalar_rgb"], "scalar_rgb"),
        (["equal_quality", "--luminaire", "bulbs"], "give --pairs"),
        (["octree_fit", "bulbs", "--references", "none"], "none"),
    ],
)
def test_bad_input_is_explained_in_one_line(mi, argv, message, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    assert main(argv) == 2
    (line,) = capsys.readouterr().err.splitlines()
    assert message in line
    assert not list(tmp_path.iterdir())


def test_a_query_from_end_to_end(mi, tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    lumitree.save(random_asset(0, tree_depth=2, l_max=0), "lamp.lumitree")
    argv = ["query", "lamp.lumitree", "--rays", "256", "--depth", "2", "-o", "out"]
    assert main([*argv, "--variant", "llvm_ad_rgb"]) == 0
    report = json.loads((tmp_path / "out" / "query.json").read_text())
    setting = report["setting"]
    for key in ("commit", "device", "variant", "lumitree", "mitsuba", "drjit", "jax"):
        assert setting[key]
    assert setting["command"].startswith("python -m benchmarks query lamp.lumitree --rays 256")
    assert setting["seconds"] > 0
    assert setting["baseline"] == "area light"
    (row,) = report["depths"]
    assert row["depth"] == 2
    assert row["over_area_light"]["area light"] == 1
    expected = row["nanoseconds"]["emission"] / row["nanoseconds"]["area light"]
    assert row["over_area_light"]["emission"] == pytest.approx(expected)
    assert report["thresholds"][0]["light"] == 1
    shown, written = capsys.readouterr().out, (tmp_path / "out" / "query.md").read_text()
    for text in (shown, written):
        assert "emission / area light" in text
        assert f"{expected:.1f}" in text


def test_commands_name_no_folders_of_the_machine():
    argv = [
        "octree_fit",
        "star",
        "--references",
        "/home/me/views",
        "--assets=../mine",
        "-o",
        "out/a",
    ]
    assert command_line(argv) == (
        "python -m benchmarks octree_fit star --references views --assets=mine -o out/a"
    )
