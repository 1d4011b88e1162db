"""The templates for farms: each has options that the commands know, and is on its page."""

import re
from pathlib import Path

import pytest

from lumitree.cli.app import _parser

FARM = Path(__file__).parent.parent / "examples" / "farm"
TEMPLATES = sorted(path.name for path in FARM.iterdir())


@pytest.mark.parametrize("name", TEMPLATES)
def test_its_options_are_those_of_a_bake_of_a_list(name):
    page = (FARM.parents[1] / "docs" / "how-to" / "farms.md").read_text(encoding="utf-8")
    assert f"examples/farm/{name}" in page
    text = (FARM / name).read_text(encoding="utf-8")
    assert set(re.findall(r"--(?:task|quality)\b", text)) == {"--task", "--quality"}
    args = ["bake", "@lamps.txt", "-o", "baked/", "--task", "2/3", "--quality", "standard"]
    assert _parser().parse_args(args).task == (2, 3)
