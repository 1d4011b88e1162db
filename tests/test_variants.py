"""Orders of imports, and Mitsuba's variants: the user's is kept, or one clear error is raised.

A variant is a property of the process, and so is libLLVM. Each case has a process of its own.
"""

import os
import subprocess
import sys
from pathlib import Path

import pytest

import lumitree
from support.fields import uniform_asset
from support.slow import slow_but_sets

# Prints what `register` does, and the variant that is set afterwards.
REGISTER = """
try:
    lumitree.register()
    print("registered", mi.variant())
except lumitree.LumitreeError as error:
    assert "\\n" not in str(error), error
    print("refused", mi.variant(), str(error))
"""
ONLY_RGB = (
    "lumitree needs a vectorised RGB variant of Mitsuba, not 'scalar_rgb'; choose llvm_ad_rgb or"
)


@pytest.fixture(scope="module")
def lamp(tmp_path_factory):
    path = tmp_path_factory.mktemp("variants") / "lamp.lumitree"
    lumitree.save(uniform_asset(10.0, [4.0, 2.0, 1.0]), path)
    return path


def run(code, *arguments, llvm=None):
    """Lines that a program prints; `llvm` is the libLLVM that the user has chosen."""
    environment = {k: v for k, v in os.environ.items() if k != "DRJIT_LIBLLVM_PATH"}
    if llvm:
        environment["DRJIT_LIBLLVM_PATH"] = llvm
    result = subprocess.run(
        [sys.executable, "-c", code, *map(str, arguments)],
        capture_output=True,
        text=True,
        env=environment,
    )
    assert result.returncode == 0, result.stderr
    return result.stdout.splitlines()


def set_variant(variant):
    return f"mi.set_variant({variant!r})\n" if variant else ""


@pytest.mark.parametrize(
    ("first", "variant"),
    slow_but_sets(
        [("mitsuba", "scalar_rgb"), ("lumitree", None)],
        ("mitsuba", "lumitree"),
        (None, "llvm_ad_rgb", "scalar_rgb"),
    ),
)
def test_either_may_be_imported_first(first, variant):
    mitsuba, ours = "import mitsuba as mi\n" + set_variant(variant), "import lumitree\n"
    code = mitsuba + ours if first == "mitsuba" else ours + mitsuba
    # If Mitsuba comes first it loads its own libLLVM, which is the subject of the next test.
    llvm = os.environ.get("DRJIT_LIBLLVM_PATH") if first == "mitsuba" else None
    (line,) = run(code + REGISTER, llvm=llvm)
    if variant == "scalar_rgb":
        assert line.startswith(f"refused scalar_rgb {ONLY_RGB}")
    elif variant:
        assert line == f"registered {variant}"
    else:
        assert line == "registered llvm_ad_rgb"


@pytest.mark.slow
def test_variants_may_be_switched(lamp):
    """Under a scalar variant lumitree refuses, and works again when another one is set."""
    code = """
import sys
import lumitree
import mitsuba as mi

path = sys.argv[1]
asset = lumitree.load(path)

def seen():
    scene = mi.load_dict({"type": "scene", "lamp": lumitree.shape(path)})
    si = scene.ray_intersect(mi.Ray3f(mi.Point3f(0.1, 0.2, 5), mi.Vector3f(0, 0, -1)))
    return si.emitter(scene).eval(si).x[0]

for variant in ("llvm_ad_rgb", "scalar_rgb", "llvm_ad_rgb", "scalar_rgb"):
    mi.set_variant(variant)
    for use in (seen, lambda: asset.eval([[0.1, 0.2, 5.0]], [[0.0, 0.0, -1.0]])[0][0, 0]):
        try:
            print(round(float(use()), 2), mi.variant())
        except lumitree.LumitreeError as error:
            assert "choose llvm_ad_rgb or cuda_ad_rgb" in str(error), error
            print("refused", mi.variant())
"""
    vectorised, scalar = 2 * ["4.0 llvm_ad_rgb"], 2 * ["refused scalar_rgb"]
    assert run(code, lamp) == vectorised + scalar + vectorised + scalar


@pytest.mark.slow
def test_a_variant_that_is_named_is_set_and_one_that_cannot_start_changes_nothing(tmp_path):
    scene = '<scene version="3.0.0"><shape type="sphere"><emitter type="area"/></shape></scene>'
    Path(tmp_path / "lamp.xml").write_text(scene)
    code = """
import sys
import mitsuba as mi
mi.set_variant("scalar_rgb")
import lumitree

for variant in (None, "llvm_ad_rgb", None, "llvm_ad_mono", "nonsense", "cuda_ad_rgb"):
    try:
        print(lumitree.load_luminaire(sys.argv[1], variant=variant).num_emitters, mi.variant())
    except lumitree.LumitreeError as error:
        assert "\\n" not in str(error), error
        print("refused", mi.variant())
"""
    *lines, last = run(code, tmp_path / "lamp.xml", llvm=os.environ.get("DRJIT_LIBLLVM_PATH"))
    assert lines == [
        "refused scalar_rgb",
        "1 llvm_ad_rgb",
        "1 llvm_ad_rgb",
        "refused llvm_ad_rgb",
        "refused llvm_ad_rgb",
    ]
    # With and without a GPU.
    assert last in ("1 cuda_ad_rgb", "refused llvm_ad_rgb")
