"""The Python in README.md runs as it stands there."""

import re
import subprocess
import sys
from pathlib import Path

import lumitree
from support.fields import random_asset

README = Path(__file__).parent.parent / "README.md"


def test_the_snippets_of_the_readme_run(tmp_path):
    lumitree.save(random_asset(0), tmp_path / "lamp.lumitree")
    blocks = re.findall(r"```python\n(.*?)```", README.read_text(encoding="utf-8"), re.DOTALL)
    assert blocks
    for block in blocks:
        # Fewer samples; everything else as it is.
        code = re.sub(r"spp=\d+", "spp=1", block)
        run = subprocess.run(
            [sys.executable, "-c", code], cwd=tmp_path, capture_output=True, text=True
        )
        assert run.returncode == 0, run.stderr
    assert (tmp_path / "room.png").stat().st_size > 1000
