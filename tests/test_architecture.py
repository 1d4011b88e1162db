"""ARCHITECTURE.md is short and names what exists, and no package outgrows its budget."""

import importlib.util
import re
import tomllib
from pathlib import Path

import budget
import pytest

ROOT = Path(__file__).parents[1]
TEXT = (ROOT / "ARCHITECTURE.md").read_text(encoding="utf-8")
PYPROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text(encoding="utf-8"))
(LAYERS,) = (
    contract["layers"]
    for contract in PYPROJECT["tool"]["importlinter"]["contracts"]
    if contract["name"] == "Dependencies point one way"
)
PACKAGES = "|".join(name for layer in LAYERS for name in layer.split(" | "))
NAMES = sorted(set(re.findall(rf"`((?:{PACKAGES})\.[\w.]+)`", TEXT)))


def test_it_has_two_pages():
    assert len(TEXT.splitlines()) <= 110


def test_its_tree_is_in_the_order_of_imports():
    tree = re.findall(r"^      (\w+)(?:/|\.py) ", TEXT, re.MULTILINE)
    assert tree == [layer.split(" | ")[0] for layer in LAYERS]


def test_one_module_uses_the_buffers_of_meshes():
    """Mitsuba 3.10 changes their names, and how a mesh is made."""
    names = r"vertex_(positions|normals|texcoords)|(faces|attribute)_buffer|mi\.Mesh\("
    names += r"|(add|remove)_attribute\(|has_(vertex|face|flipped)_\w+\(|recompute_\w+\("
    files = [*(ROOT / "src").rglob("*.py"), *(ROOT / "benchmarks").rglob("*.py")]
    found = [each for each in files if re.search(names, each.read_text(encoding="utf-8"))]
    assert found == [ROOT / "src/lumitree/core/mitsuba_meshes.py"]


def test_numbers_of_lanes_are_not_in_the_code_of_kernels():
    """`core.device.channel_mean` and `core.device.concatenate` do not compile a kernel each."""
    names = r"dr\.(mean|concat)\((?!`)"
    files = (ROOT / "src").rglob("*.py")
    assert [each for each in files if re.search(names, each.read_text(encoding="utf-8"))] == []


def test_the_house_keeps_its_budget():
    """More needs a reason in the message of the commit that raises a number in budget.py."""
    lines = budget.lines_by_package()
    assert {name for name in lines if lines[name] > budget.LINES.get(name, 0)} == set()
    assert len(budget.modules()) <= budget.FILES
    others = budget.others()
    assert {name for name in others if others[name] > budget.OTHERS[name]} == set()


@pytest.mark.parametrize("name", NAMES)
def test_a_name_is_of_a_module_or_in_it(name):
    """Modules are found without importing them: some import Mitsuba."""
    module = f"lumitree.{name}"
    if importlib.util.find_spec(module.rpartition(".")[0]) is None:
        pytest.fail(f"{module} has no parent")
    try:
        found = importlib.util.find_spec(module)
    except ModuleNotFoundError:  # the parent is no package
        found = None
    if found is None:
        parent, _, symbol = module.rpartition(".")
        source = Path(str(importlib.util.find_spec(parent).origin)).read_text(encoding="utf-8")
        assert re.search(rf"^(def|class) {symbol}\b|^{symbol}\b.*=", source, re.MULTILINE)
