"""What an asset may have, Mitsuba makes, and gives values of that are finite and not negative."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest


def faults(count):
    """By `scalar_materials.py`, which tries thousands of materials without compiling any."""
    script = Path(__file__).with_name("scalar_materials.py")
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(sys.path)}
    run = subprocess.run(
        [sys.executable, str(script), str(count)], env=environment, capture_output=True, text=True
    )
    assert run.returncode == 0, run.stderr[-2000:]
    return json.loads(run.stdout)


def test_materials_that_are_accepted_can_be_rendered():
    found = faults(500)
    assert found["faults"] == {}
    assert found["tried"] > 1800
    assert found["accepted"] > 800


@pytest.mark.slow
def test_all_pairs_of_parameters_can_be_rendered():
    found = faults(0)
    assert found["faults"] == {}
    assert found["accepted"] > 10000
