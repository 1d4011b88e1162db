"""A lamp's file is parsed once, and its scene is created once for each place."""

from collections import Counter

import numpy as np
import pytest

from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.stored_geometry import stored_geometry
from lumitree.rendering.scene import place_shapes

LAMP = """<scene version="3.0.0">
<shape type="sphere"><float name="radius" value="0.5"/><point name="center" value="{place}"/>
<emitter type="area"><rgb name="radiance" value="3,2,1"/></emitter></shape></scene>"""


@pytest.fixture
def calls(mi, monkeypatch):
    """How often files were parsed and scenes created."""
    counted = Counter()
    parse, instantiate = mi.parser.parse_file, mi.parser.instantiate

    def count(name, call):
        def counting(*arguments):
            counted[name] += 1
            return call(*arguments)

        monkeypatch.setattr(mi.parser, name, counting)

    count("parse_file", parse)
    count("instantiate", instantiate)
    return counted


def write(folder, place):
    path = folder / "lamp.xml"
    path.write_text(LAMP.format(place=place))
    return path


def test_a_lamp_and_its_geometry(calls, tmp_path):
    lamp = load_luminaire(write(tmp_path, "1,0,0"))
    geometry = stored_geometry(lamp)
    assert [shape.type for shape in geometry.shapes] == ["sphere"]
    assert calls == {"parse_file": 1, "instantiate": 1}


def test_places_do_not_change_the_lamp(calls, tmp_path):
    lamp = load_luminaire(write(tmp_path, "1,0,0"))
    doubled, moved = np.diag([2.0, 2, 2, 1]), np.eye(4)
    moved[:3, 3] = 0, 3, 0
    centres = []
    for matrix in (doubled, moved, np.eye(4)):
        (shape,) = place_shapes(lamp, matrix).values()
        centres.append(np.ravel(shape.bbox().center()))
    np.testing.assert_allclose(centres, [[2, 0, 0], [1, 3, 0], [1, 0, 0]], atol=1e-6)
    assert calls == {"parse_file": 1, "instantiate": 4}
