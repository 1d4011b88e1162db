"""Floor plans below illuminance: walls, furniture and lamps where they are in the scene."""

import numpy as np
import pytest
from matplotlib.colors import to_rgb
from matplotlib.figure import Figure

import lumitree
from lumitree.measure.figures import _LAMPS, _draw_plan
from lumitree.measure.floor_plan import floor_plan
from lumitree.rendering.scene import open_placements
from support.ies_text import ies_text


def cube(mi, low, high):
    """A box between two corners."""
    low, high = np.array(low, float), np.array(high, float)
    move = mi.ScalarTransform4f().translate(((low + high) / 2).tolist())
    return {"type": "cube", "to_world": move.scale(((high - low) / 2).tolist())}


@pytest.fixture
def scene(mi):
    """A room of 4 m x 3 m with a pillar and, below the plane, a bed."""
    return {
        "type": "scene",
        "room": cube(mi, (10, 0, 20), (14, 2.5, 23)),
        "pillar": cube(mi, (11, 0, 21), (11.2, 2.5, 21.3)),
        "bed": cube(mi, (12, 0, 21), (13.5, 0.5, 22.5)),
    }


@pytest.fixture
def lamp(tmp_path):
    path = tmp_path / "lamp.ies"
    path.write_text(ies_text([[10, 10, 0]], c=[0], gamma=[0, 90, 180], opening=(0.2, 0.6, 0.1)))
    return lumitree.Placement(str(path), at=(12, 2.2, 21))


def marked(mask, low, high):
    """Whether a pixel is marked near (x, z) of the scene; v is -z."""
    pixel = (high - low).max() / 600

    def near(x, z):
        column, row = np.round((np.array([x, -z]) - low) / pixel).astype(int)
        return mask[max(row - 2, 0) : row + 3, max(column - 2, 0) : column + 3].any()

    return near


def test_walls_furniture_and_lamps_are_where_they_are(mi, scene, lamp):
    plane = lumitree.Plane((12, 0.75, 21.5), (0, 1, 0), extent=(3.8, 2.8), spacing=0.5)
    (placed,) = open_placements([lamp])
    found = floor_plan(plane, mi.load_dict(scene), [placed])
    # The whole room, though the plane is smaller.
    assert (found.low < [10, -23]).all()
    assert (found.high > [14, -20]).all()
    crosses = marked(found.section, found.low, found.high)
    steps = marked(found.edges & ~found.section, found.low, found.high)
    for x, z in ((10, 22), (14, 22), (13, 20), (13, 23), (11, 21.1), (11.2, 21.1), (11.1, 21.3)):
        assert crosses(x, z), (x, z)
    for x, z in ((12, 22), (13.5, 22), (13, 21), (13, 22.5)):
        assert (steps(x, z), crosses(x, z)) == (True, False), (x, z)
    for x, z in ((12.7, 21.7), (10.5, 21), (11.1, 21.15)):
        assert (steps(x, z), crosses(x, z)) == (False, False), (x, z)
    (outline,) = found.lamps
    np.testing.assert_allclose(outline.min(axis=0), [11.7, -21.1], atol=1e-3)
    np.testing.assert_allclose(outline.max(axis=0), [12.3, -20.9], atol=1e-3)


def test_plans_have_coordinates_of_the_scene_and_a_legend(scene, lamp):
    plane = lumitree.Plane((12, 0.25, 21.5), (0, 1, 0), extent=(3.8, 2.8), spacing=0.4, name="low")
    result = lumitree.illuminance(scene, [lamp], planes=[plane], error=0.5, direct=True)
    (area,) = result.areas
    assert area.enclosed > 0
    figure = Figure()
    axes = figure.subplots()
    _draw_plan(figure, axes, result.plans()[0], True)
    assert axes.get_title() == (
        f"low: direct illuminance, mean {area.mean:.4g} lx, U0 {area.uniformity:.2f}"
    )
    assert (axes.get_xlabel(), axes.get_ylabel()) == ("x, m", "z, m")
    assert axes.yaxis.get_major_formatter()(-22, 0) == "22"
    assert axes.xaxis.get_major_formatter()(11, 0) == "11"
    legend = axes.get_legend()
    assert legend is not None
    labels = [each.get_text() for each in legend.get_texts()]
    assert labels == ["section of the room", "lamp", "inside a solid, not counted"]
    # The point of each number is where its illuminance is.
    x, y = axes.texts[0].get_position()
    assert [x, -y] == pytest.approx(result.position[0, [0, 2]])
    assert to_rgb(axes.patches[0].get_edgecolor()) == to_rgb(_LAMPS)
