"""The benchmark of many lamps: its lamps, its model, and a run of a few lamps."""

import json

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.baked_folders.farm import STORAGE_BYTES, farm
from benchmarks.baked_folders.lamps import lamp, write_lamps
from benchmarks.many_lamps import bake_table
from lumitree.errors import LumitreeError

COSTS = {"lamp_bytes": 1e6, "check": 0.001, "start": 3.0, "page": 0.002}


def test_the_model_divides_equal_lamps_evenly():
    found = farm([2.0], **COSTS, lamps=1000, machines=10)
    assert found.bake == found.dynamic == found.tasks == 200
    assert found.check == pytest.approx(0.1)
    assert found.bytes == 1e9
    assert found.storage == 1e9 / STORAGE_BYTES
    assert found.page == pytest.approx(2)
    assert found.bound == "the bakes"
    assert farm([2.0], **COSTS, lamps=1001, machines=10).tasks == 202


def test_the_model_of_unequal_lamps():
    """Lamp by lamp, the last one is at most the longest lamp later than an even division."""
    seconds = np.random.default_rng(0).lognormal(1, 1, 137)
    found = farm(seconds, **COSTS, lamps=2000, machines=16)
    assert found.bake == pytest.approx(np.resize(seconds, 2000).sum() / 16)
    assert found.bake <= found.dynamic <= found.bake + seconds.max()
    assert found.dynamic <= found.tasks


def test_lamps_differ_and_are_the_same_every_time(tmp_path):
    texts = [lamp(index, 0) for index in range(9)]
    assert len(set(texts)) == 9
    assert texts[4] == lamp(4, 0) != lamp(4, 1)
    write_lamps(tmp_path / "work", 5, 0)
    names = (tmp_path / "work" / "lamps.txt").read_text().split()
    assert len(names) == 5
    assert all((tmp_path / "work" / name).is_file() for name in names)
    write_lamps(tmp_path / "work", 5, 0)
    with pytest.raises(LumitreeError, match="work has other lamps"):
        write_lamps(tmp_path / "work", 6, 0)


def test_the_efficiency_is_the_median_of_rounds():
    """A round in which the machine did other work counts for no more than another."""
    table = bake_table(
        [
            {
                "workers": 1,
                "seconds": 330.0,
                "rounds": [100, 110, 120],
                "peak_bytes": 1,
                "calls": 3,
            },
            {"workers": 2, "seconds": 250.0, "rounds": [50, 140, 60], "peak_bytes": 1, "calls": 3},
        ],
        lamps=30,
    )
    assert [line[3] for line in table.rows] == ["1.000", "1.000"]


@pytest.mark.slow
def test_a_run_in_rounds_bakes_other_lamps_in_each(mi, tmp_path):
    argv = ["many_lamps", "--work", str(tmp_path / "work"), "--lamps", "1", "--workers", "1"]
    assert main([*argv, "--rounds", "2", "-o", str(tmp_path / "out")]) == 0
    report = json.loads((tmp_path / "out" / "many_lamps.json").read_text())
    (row,) = report["bakes"]
    assert len(row["rounds"]) == row["calls"] == 2
    assert row["seconds"] == pytest.approx(sum(row["rounds"]))
    first, second = (tmp_path / f"work/round-{k}/lamps/lamp-00000.xml" for k in (1, 2))
    assert first.read_text() != second.read_text()


@pytest.mark.slow
def test_a_run_of_three_lamps_continues(mi, tmp_path, capsys):
    argv = ["many_lamps", "--work", str(tmp_path / "work"), "--lamps", "3", "--workers", "1"]
    for _ in range(2):
        assert main([*argv, "-o", str(tmp_path / "out")]) == 0
    report = json.loads((tmp_path / "out" / "many_lamps.json").read_text())
    (row,) = report["bakes"]
    assert row["calls"] == 1
    assert row["peak_bytes"] > 1e8
    assert report["folder"]["bytes"]["assets"] > 1000
    assert report["farm"]["bound"] == "the bakes"
    assert "efficiency" in capsys.readouterr().out
