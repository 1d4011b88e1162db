"""The stubs that the type checker reads describe what is installed."""

import ast
import functools
from pathlib import Path

import pytest

TYPINGS = Path(__file__).parent.parent / "typings"
STUBS = sorted(TYPINGS.rglob("*.pyi"))


def declared(body):
    """Names that statements of a stub declare, with the bodies of classes."""
    for node in body:
        if isinstance(node, ast.ClassDef):
            yield node.name, node.body
        elif isinstance(node, ast.FunctionDef):
            yield node.name, []
        elif isinstance(node, ast.AnnAssign):
            yield node.target.id, []


def test_there_are_stubs():
    assert STUBS


@pytest.mark.parametrize("stub", STUBS, ids=lambda path: path.relative_to(TYPINGS).as_posix())
def test_every_name_exists(mi, stub):
    package, *parts = stub.relative_to(TYPINGS).with_suffix("").parts
    # Some of Mitsuba's modules are attributes only.
    parts = [part for part in parts if part != "__init__"]
    module = functools.reduce(getattr, parts, pytest.importorskip(package))
    missing = []
    for name, body in declared(ast.parse(stub.read_text()).body):
        if name.startswith("_"):
            continue
        found = getattr(module, name, None)
        if found is None:
            missing.append(name)
        members = [member for member, _ in declared(body) if not member.startswith("__")]
        missing += [f"{name}.{member}" for member in members if not hasattr(found, member)]
    assert not missing
