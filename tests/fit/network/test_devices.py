"""Steps that several devices share, against the same steps on one."""

import json
import os
import subprocess
import sys
from pathlib import Path

import jax
import numpy as np
import pytest

from lumitree.fit.network.step import initial_state
from lumitree.fit.network.train import load_run, train
from support.four_devices import steps
from support.sphere import TINY, sphere_dataset

RESUMED = """
import sys
from lumitree.fit.network.train import train
from support.sphere import TINY
dataset, run = sys.argv[1:]
train(dataset, run, TINY, stop_after=2)
train(dataset, run, TINY, resume=True, stop_after=2)
"""


def _run_with_four(*command):
    environment = os.environ | {
        "XLA_FLAGS": "--xla_force_host_platform_device_count=4",
        "PYTHONPATH": os.pathsep.join(sys.path),
    }
    ended = subprocess.run(
        [sys.executable, *map(str, command)], env=environment, capture_output=True, text=True
    )
    assert ended.returncode == 0, ended.stderr
    return ended.stdout


def _assert_equal_to_rounding(one, four, start):
    for first, second, before in zip(one, four, start, strict=True):
        moved = np.abs(first - before).max()
        assert moved > 1e-3
        np.testing.assert_allclose(first, second, rtol=0, atol=1e-3 * moved)


@pytest.mark.slow
def test_four_devices_give_the_result_of_one(tmp_path):
    dataset = sphere_dataset(tmp_path / "sphere", views=4).folder
    script, output = (
        Path(__file__).parents[2] / "support" / "four_devices.py",
        tmp_path / "four.npz",
    )
    found = json.loads(_run_with_four(script, dataset, output).splitlines()[-1])
    assert len(jax.devices()) == 1
    start, one, operations = steps(dataset)
    assert found["shared"] == [4, 3, 1]
    # Each has a quarter of the work.
    assert 0.2 < found["operations"] / operations < 0.35
    with np.load(output) as four:
        _assert_equal_to_rounding(one, [four[name] for name in four.files], start)


@pytest.mark.slow
def test_a_run_on_four_devices_can_be_read_on_one(tmp_path):
    dataset = sphere_dataset(tmp_path / "sphere").folder
    train(dataset, tmp_path / "one", TINY, stop_after=4)
    _run_with_four("-c", RESUMED, dataset, tmp_path / "four")
    template = initial_state(TINY, 0.1)[1]
    one, four = (load_run(tmp_path / name).state for name in ("one", "four"))
    assert int(four.step) == 4
    leaves = [[np.asarray(x) for x in jax.tree.leaves(s.params)] for s in (one, four, template)]
    _assert_equal_to_rounding(*leaves)
