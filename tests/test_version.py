"""One version, in all files that state it, and what a release needs."""

import re
import runpy
import tomllib
from pathlib import Path

import pytest
from packaging.requirements import Requirement
from packaging.utils import canonicalize_name

import lumitree

ROOT = Path(__file__).parents[1]
EXTENSION = ROOT / "integrations/blender/lumitree_blender/blender_manifest.toml"


def read(path):
    return (ROOT / path).read_text(encoding="utf-8")


PROJECT = tomllib.loads(read("pyproject.toml"))["project"]


def test_all_files_agree():
    stated = runpy.run_path(str(ROOT / "src/lumitree/_version.py"))["__version__"]
    assert lumitree.__version__ == stated
    assert re.findall(r"^version: (.*)$", read("CITATION.cff"), re.MULTILINE) == [stated]
    assert tomllib.loads(EXTENSION.read_text(encoding="utf-8"))["version"] == stated


def test_constraints_are_within_what_is_required():
    pins = [line for line in read("constraints.txt").splitlines() if line and line[0] != "#"]
    split = (pin.partition("==") for pin in pins)
    versions = {canonicalize_name(name): number for name, _, number in split}
    groups = [PROJECT["dependencies"], *PROJECT["optional-dependencies"].values()]
    for requirement in [Requirement(text) for group in groups for text in group]:
        name = canonicalize_name(requirement.name)
        if name != "lumitree" and name in versions:
            assert requirement.specifier.contains(versions[name]), requirement
    required = {canonicalize_name(Requirement(text).name) for text in PROJECT["dependencies"]}
    assert required <= versions.keys()


NULL_ROOM = {
    "type": "scene",
    "integrator": {"type": "path"},
    "sensor": {
        "type": "orthographic",
        "film": {"type": "hdrfilm", "width": 4, "height": 4, "rfilter": {"type": "box"}},
    },
    "floor": {"type": "rectangle", "bsdf": {"type": "diffuse"}},
}


def test_path_of_mitsuba_does_not_cross_null_surfaces_in_shadow_rays(mi):
    """So `lumitree render` replaces it by `lumitree_path`. Mitsuba 3.10 changes this."""
    assert hasattr(mi.BSDF, "eval_null_transmission")
    assert not hasattr(mi.BSDF, "eval_null")
    look = mi.ScalarTransform4f().look_at([0, 0, 1], [0, 0, 0], [0, 1, 0])
    room = NULL_ROOM | {"sensor": NULL_ROOM["sensor"] | {"to_world": look}}
    room["light"] = {"type": "point", "position": [0, 0, 3]}
    open_room = mi.render(mi.load_dict(room), spp=1)
    veil = mi.ScalarTransform4f().translate([0, 0, 2])
    room["veil"] = {"type": "rectangle", "to_world": veil, "bsdf": {"type": "null"}}
    veiled = mi.render(mi.load_dict(room), spp=1)
    assert open_room.array[0] > 0
    assert veiled.array[0] == pytest.approx(0)
