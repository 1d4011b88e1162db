"""The worked example of docs/units.md."""

import math
import re
from pathlib import Path

import pytest

import lumitree

PAGE = Path(__file__).parents[2] / "docs/units.md"


def stated(label):
    """The numbers of a row of the page's first table of the lamp."""
    row = next(line for line in PAGE.read_text().splitlines() if line.startswith(f"| {label}"))
    numbers = re.findall(r"[\d,]*\.?\d+", row.split("|")[-2])
    return [float(number.replace(",", "")) for number in numbers]


def test_the_lamp_of_the_page_has_the_values_of_the_page(mi):
    lumens, watts = stated("flux |")
    luminance, radiance = stated("luminance of its surface")
    lamp = {
        "type": "sphere",
        "center": [0, 2, 0],
        "radius": 0.05,
        "emitter": {"type": "area", "radiance": {"type": "rgb", "value": radiance}},
        "bsdf": {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}},
    }
    scene = {"type": "scene", "lamp": lamp}
    measured = lumitree.photometry(scene, paths=1 << 16, progress=None)
    assert measured.lumens.value == pytest.approx(lumens, rel=2e-3)
    assert watts == pytest.approx(lumens / 683, rel=1e-4)
    assert luminance == pytest.approx(683 * radiance, rel=1e-3)
    below = lumitree.illuminance(scene, points=[[0, 0, 0]], normals=[0, 1, 0], error=1e-3)
    (lux,) = stated("illuminance of the table")
    assert below.direct[0] == pytest.approx(lux, rel=3e-3)
    candela, per_steradian = stated("intensity |")
    assert candela == pytest.approx(lumens / (4 * math.pi), rel=1e-4)
    assert per_steradian == pytest.approx(candela / 683, rel=1e-3)
    (grey,) = stated("luminance of the table")
    assert grey == pytest.approx(0.5 * lux / math.pi, rel=1e-3)
