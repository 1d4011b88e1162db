"""The examples run, in their order."""

import os
import subprocess
import sys
from pathlib import Path

import pytest

EXAMPLES = sorted((Path(__file__).parent.parent / "examples").glob("*.py"))


@pytest.mark.slow
def test_examples(tmp_path):
    assert len(EXAMPLES) >= 3
    for example in EXAMPLES:
        result = subprocess.run(
            [sys.executable, example], cwd=tmp_path, capture_output=True, text=True
        )
        assert result.returncode == 0, result.stderr
    names = set(os.listdir(tmp_path))
    assert {"ball.lumitree", "two_balls.png", "comparison.png", "desk_lamp_fit.png"} <= names
