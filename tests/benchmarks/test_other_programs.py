"""The benchmark `other_programs`: its sum over lights, and all targets of a small lamp."""

import json
from importlib.util import find_spec

import numpy as np
import pytest

import lumitree
from benchmarks.__main__ import main
from benchmarks.exported_files.lights import ReadLight, summed_lux
from support.exported_lamps import lamp


def test_lights_follow_the_inverse_square_and_the_cosine():
    """Two lights, one of which shines upwards only; surfaces that face away are dark."""
    even = ReadLight(np.array([0.0, 2, 0]), lambda direction: np.full(len(direction), 8.0))
    upwards = ReadLight(np.zeros(3), lambda direction: 5.0 * (direction[:, 1] > 0.1))
    points = np.array([[0.0, 0, 1e-9], [2, 0, 0], [0, 3, 0], [0, 3, 0]])
    normals = np.array([[0.0, 1, 0], [0, 1, 0], [0, -1, 0], [0, 1, 0]])
    expected = [8 / 4, 8 / 8 / np.sqrt(2), 8 + 5 / 9, 0]
    assert summed_lux([even, upwards], points, normals) == pytest.approx(expected, rel=1e-6)


@pytest.fixture(scope="module")
def rows(tmp_path_factory):
    """Rows of a lamp of 20 cells with a light for each, and the table's text."""
    folder = tmp_path_factory.mktemp("programs")
    lumitree.save(lamp(), folder / "small.lumitree")
    arguments = ["small", "--assets", str(folder), "-o", str(folder), "--lights", "20"]
    assert main(["other_programs", *arguments, "--error", "0.005"]) == 0
    found = json.loads((folder / "other_programs.json").read_text())["rows"]
    text = (folder / "other_programs.md").read_text()
    return {row["target"]: row for row in found}, text


@pytest.mark.slow
@pytest.mark.parametrize(
    ("target", "package"),
    [
        ("Radiance, .rad", "pyradiance"),
        ("IES files, by ies2rad", "pyradiance"),
        ("pbrt-v4, .pbrt", None),
        ("OpenUSD, .usda", "pxr"),
        ("glTF, .glb", None),
        ("IES files", None),
    ],
)
def test_a_light_for_each_cell_gives_the_illuminance_of_the_lamp(rows, target, package):
    row = rows[0][target]
    if package is not None and find_spec(package) is None:
        assert "install" in row["left_out"]
        assert f"{target} is left out" in rows[1]
        return
    assert row["ratio"] == pytest.approx(1, abs=0.02)
    # pbrt takes the nearest texel, a quarter of a bin, of intensities that are random by bin.
    assert row["rms"] < 0.05
    assert f"| small | {target} |" in rows[1]


@pytest.mark.slow
def test_cycles_is_left_out_visibly_without_blender(rows):
    row = rows[0]["Blender's Cycles, .py"]
    assert "left_out" in row or row["ratio"] == pytest.approx(1, abs=0.02)
    assert "| Blender's Cycles, .py | program |" in rows[1]
