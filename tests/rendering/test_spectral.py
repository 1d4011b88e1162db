"""Spectral variants show the colours of RGB variants; RGB light as spectra."""

import json
import subprocess
import sys
from pathlib import Path

import numpy as np
import pytest

import support.spectral_images as images
from support.slow import slow
from support.variant import VARIANT

SPECTRAL = VARIANT.replace("_rgb", "_spectral")
IMAGES = Path(images.__file__)
TABLES = IMAGES.with_name("spectral_tables.py")


# Modules of `support` are found as here.
START = """
import runpy, sys
sys.path.insert(0, sys.argv[1])
sys.argv = sys.argv[2:]
runpy.run_path(sys.argv[0], run_name="__main__")
"""


def run(script, *arguments):
    """Output of a script that runs in a process of its own."""
    command = [sys.executable, "-c", START, script.parent.parent, script, *arguments]
    result = subprocess.run(list(map(str, command)), capture_output=True, text=True)
    assert result.returncode == 0, result.stderr
    return result.stdout


def assert_equal_colours(folder, samples, names):
    """Images of lamps have equal colours in RGB and in spectral variants, within 2 %."""
    printed = run(IMAGES, SPECTRAL, folder, samples, *names)
    found = json.loads(printed.splitlines()[-1])
    for name, expected in images.mean_colours(folder, VARIANT, samples, names).items():
        assert np.min(expected) > 0
        assert np.array(found[name]) == pytest.approx(np.array(expected), rel=0.02), name


@pytest.mark.slow
def test_a_baked_lamp_has_the_colours_of_rgb_variants(mi, tmp_path):
    images.write_lamps(tmp_path, ["baked"])
    assert_equal_colours(tmp_path, 1024, ["baked"])


@pytest.mark.slow
@pytest.mark.filterwarnings("ignore::lumitree.errors.LumitreeWarning")
def test_all_kinds_of_lamps_have_the_colours_of_rgb_variants(mi, tmp_path):
    images.write_lamps(tmp_path, ["textured"])
    assert_equal_colours(tmp_path, 4096, ["textured", "spectrum", "field", "blackbody"])


@pytest.fixture(scope="module")
def tables():
    return json.loads(run(TABLES, SPECTRAL).splitlines()[-1])


def test_the_basis_is_a_partition_of_unity(tables):
    smallest, error = tables["basis"]
    assert smallest >= 0
    assert error < 1e-12


@pytest.mark.parametrize("spectrum", ["none", "incandescent", "peaks"])
def test_light_keeps_its_colour_and_lamps_their_spectrum(tables, spectrum):
    found = tables[spectrum]
    assert found["colour"] < 1e-6
    assert found["own"] < 1e-6


def test_without_a_spectrum_no_light_is_negative(tables):
    assert tables["none"]["smallest"] > -1e-4
    # A spectrum of a part of the flux is none.
    assert tables["unknown"] == 0


def test_a_lamp_of_one_line_keeps_its_luminance(tables):
    assert tables["line"] < 1e-6


def test_the_kernel_interpolates_the_table(tables):
    assert tables["kernel"] < 1e-4


@pytest.mark.parametrize(
    ("command", "message"),
    [
        (["render", "room.xml", "-o", "a.png", "--denoise"], "denoise, layers and aov need an RGB"),
        slow(["render", "room.xml", "-o", "a.png", "--layers", "a.exr"], "need an RGB variant"),
        (["photometry", "bulbs"], "spectral variants only render scenes"),
        slow(["preview", "bulbs", "-o", "a.png"], "spectral variants only render scenes"),
        slow(["capture", "bulbs", "-o", "views"], "spectral variants only render scenes"),
    ],
)
def test_what_needs_rgb_is_refused_in_one_line(tmp_path, command, message):
    program = [sys.executable, "-m", "lumitree", *command, "--variant", SPECTRAL]
    result = subprocess.run(program, capture_output=True, text=True, cwd=tmp_path)
    assert result.returncode == 2
    assert message in result.stderr
    assert result.stderr.count("\n") == 1
    assert not list(tmp_path.iterdir())
