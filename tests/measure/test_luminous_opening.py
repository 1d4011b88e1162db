"""The luminous opening and the photometric centre of lamps: where their light leaves."""

import json
import os
from pathlib import Path

import numpy as np
import pytest

import lumitree
from lumitree.cli import main
from lumitree.formats.ies import read_ies
from lumitree.formats.ldt import ldt_of, read_ldt
from lumitree.formats.opening import Opening, opening_around
from lumitree.formats.type_c import Grid, IntensityDistribution
from lumitree.measure.photometric_figures import CATALOGUE_ROOM
from support.slow import slow

# C of the direction in which the foot of `little_lamp` throws a shadow.
SHADED = 180
DATA = Path(os.environ.get("LUMITREE_DATA", Path(__file__).parents[2].parent / "shared" / "data"))
# A ball of 806 lm on a foot: its radius and height, and the diameter of the foot, m.
LUMENS, RADIUS, HEIGHT, FOOT = 806.0, 0.03, 0.8, 0.2
BLACK = (
    '<bsdf type="twosided"><bsdf type="diffuse"><rgb name="reflectance" value="0"/></bsdf></bsdf>'
)
EMITTED = LUMENS / 683 / (4 * np.pi**2 * RADIUS**2)
LAMP = f"""<scene version="3.0.0">
<shape type="sphere" id="ball"><float name="radius" value="{RADIUS}"/>
<point name="center" x="0" y="{HEIGHT}" z="0"/>
<emitter type="area"><rgb name="radiance" value="{EMITTED}"/></emitter></shape>
<shape type="cylinder" id="stem"><float name="radius" value="0.004"/>
<point name="p0" x="0" y="0" z="0"/><point name="p1" x="0" y="{HEIGHT - 1.2 * RADIUS}" z="0"/>
{BLACK}</shape>
<shape type="disk" id="foot"><transform name="to_world"><scale value="{FOOT / 2}"/>
<rotate x="1" angle="-90"/></transform>{BLACK}</shape></scene>"""


def random_ball(count=20_000):
    points = np.random.default_rng(0).normal(size=(count, 3))
    return points / np.linalg.norm(points, axis=1, keepdims=True)


def random_cube(*sides, count=20_000):
    return (np.random.default_rng(1).random((count, 3)) - 0.5) * sides


@pytest.mark.parametrize(
    ("points", "shape", "sides"),
    [
        (random_ball() * 0.05, "ellipsoid", (0.1, 0.1, 0.1)),
        (random_ball() * [0.1, 0.2, 0.05], "ellipsoid", (0.2, 0.4, 0.1)),
        (random_cube(0.6, 0.1, 0.3), "box", (0.6, 0.1, 0.3)),
        (random_cube(0.6, 0, 0.3), "box", (0.6, 0, 0.3)),
        (random_ball()[:, [0, 1, 2]] * [0.1, 0, 0.1], "ellipsoid", (0.2, 0, 0.2)),
        (random_cube(1.2, 0, 0), "box", (1.2, 0, 0)),
        (random_cube(0, 0, 0), "box", (0, 0, 0)),
    ],
)
def test_openings_of_simple_shapes(points, shape, sides):
    place = np.array([1.0, 2, 3])
    opening, centre = opening_around(points + place, np.ones(len(points)))
    assert opening.shape == shape
    assert opening.sides == pytest.approx(sides, rel=0.03)
    assert centre == pytest.approx(place, abs=0.015)


def test_light_far_from_a_lamp_does_not_widen_its_opening():
    """1.8 % of the light comes from a foot 0.8 m below."""
    ball = random_ball() * 0.05
    foot = random_cube(0.2, 0, 0.2) - [0, 0.8, 0]
    flux = np.repeat([0.982, 0.018], len(ball))
    opening, centre = opening_around(np.concatenate([ball, foot]), flux)
    assert opening.sides == pytest.approx((0.1, 0.1, 0.1), rel=0.05)
    assert centre == pytest.approx([0, 0, 0], abs=0.01)


@pytest.fixture(scope="module")
def measured(mi, tmp_path_factory):
    """Photometry of the ball on its foot, and the folder of its files."""
    folder = tmp_path_factory.mktemp("lamp")
    (folder / "lamp.xml").write_text(LAMP)
    files = [folder / "lamp.ies", folder / "lamp.ldt"]
    return lumitree.photometry(
        folder / "lamp.xml", files, paths=1 << 20, step=15, progress=None
    ), folder


def test_the_opening_is_where_light_leaves(measured):
    result, folder = measured
    assert result.opening.shape == "ellipsoid"
    assert result.opening.sides == pytest.approx([2 * RADIUS] * 3, rel=0.06)
    # From the middle of the box, which reaches from the foot to the top of the ball.
    assert result.opening_centre == pytest.approx((0, HEIGHT - (HEIGHT + RADIUS) / 2, 0), abs=2e-3)
    written = read_ies(folder / "lamp.ies").opening
    assert (written.shape, written.sides) == (
        "ellipsoid",
        pytest.approx(result.opening.sides, abs=1e-6),
    )
    stated = result.to_json()
    assert stated["opening"]["sides"] == list(result.opening.sides)
    assert stated["opening_centre"] == list(result.opening_centre)
    # The box is stated, too.
    assert stated["size"] == pytest.approx([FOOT, HEIGHT + RADIUS, FOOT])


def test_an_area_of_eulumdat_is_as_large_as_the_ball_it_stands_for(measured):
    _, folder = measured
    x, height, z = read_ldt(folder / "lamp.ldt").opening.sides
    area = np.pi * RADIUS**2
    assert np.pi / 4 * x * z == pytest.approx(area, rel=0.12)
    assert z * height == pytest.approx(area, rel=0.12)
    grid = Grid(30)
    light = IntensityDistribution(
        "lamp", grid.c, grid.gamma, np.ones((12, 7)), Opening((0.2, 0.1, 0.4), "ellipsoid")
    )
    header = ldt_of(light).header
    area = header.length_lum_area * header.width_lum_area
    assert area == pytest.approx(np.pi / 4 * 200 * 400)
    assert header.length_lum_area * header.h_lum_c0 == pytest.approx(np.pi / 4 * 400 * 100)


def lux(placement, point, side=1e-4):
    """Mean illuminance of a square around a point, which faces the origin, lx."""
    spacing = max(side / 16, 1e-4)
    plane = lumitree.Plane(point, tuple(-np.array(point)), extent=(side, side), spacing=spacing)
    floor = {"type": "sphere", "center": [0, -90, 0], "radius": 0.1}
    room = {"type": "scene", "floor": floor}
    found = lumitree.illuminance(
        room, [placement], planes=[plane], direct=True, progress=None, error=0.01
    )
    return float(found.total.mean())


@pytest.mark.parametrize("name", ["lamp.ies", "lamp.ldt"])
@pytest.mark.parametrize("direction", [slow((1, 0, 0)), slow((0.3, 1, 0)), (0.6, -0.3, 0.5)])
def test_a_file_gives_the_light_of_the_ball_from_five_times_the_opening(measured, name, direction):
    """E = Φ / 4 pi d² of a Lambertian ball, at any distance."""
    _, folder = measured
    distance = 5 * 2 * RADIUS
    point = distance * np.array(direction) / np.linalg.norm(direction)
    lamp = lumitree.Placement(folder / name, at=(0, 0, 0))
    expected = LUMENS / (4 * np.pi * distance**2)
    assert lux(lamp, tuple(point.tolist())) == pytest.approx(expected, rel=0.05)


def test_the_glare_of_a_bare_lamp_is_that_of_its_ball(measured):
    """A ball of 22,700 cd/m² glares; its box, 35 times as large, gave a rating of 8."""
    pytest.importorskip("eulumdat_ugr")
    result, _ = measured
    assert 19 < result.ugr[CATALOGUE_ROOM, 0] < 27


def test_the_report_states_the_opening(measured, capsys, monkeypatch):
    _, folder = measured
    monkeypatch.chdir(folder)
    command = ["photometry", "lamp.xml", "-o", "lamp.html", "--json", "lamp.json"]
    assert main([*command, "--paths", "16384", "--step", "15"]) == 0
    printed = capsys.readouterr().out
    assert "luminous opening  ellipsoid, 0.0" in printed
    assert "from the centre of the bounding box" in printed
    assert "ellipsoid, 0.0" in (folder / "lamp.html").read_text()
    assert json.loads((folder / "lamp.json").read_text())["opening"]["shape"] == "ellipsoid"


@pytest.fixture(scope="module")
def desk_lamp(mi, tmp_path_factory):
    """little_lamp, which stands on a foot: the largest side of its opening, its directions that are
    checked for the inverse-square law, and the asset and the file, the opening at the origin."""
    if not DATA.is_dir():
        pytest.skip(f"no {DATA}")
    baked, file = (tmp_path_factory.mktemp("desk") / f"lamp.{kind}" for kind in ("lumitree", "ies"))
    lumitree.bake(DATA / "luminaires" / "little_lamp" / "luminaire.xml", baked)
    result = lumitree.photometry(str(baked), file, progress=None)
    largest = max(result.opening.sides)
    assert largest < 0.6 * max(result.size)
    asset = lumitree.Placement(str(baked), at=tuple(-np.array(result.opening_centre)))
    limits = [each for each in result.near_field if each.candela > 0.2 * result.max_candela.value]
    return largest, limits, asset, lumitree.Placement(str(file), at=(0, 0, 0))


def lux_of_both(desk_lamp, limit, part=0.0):
    """Illuminance by the asset and by the file, five openings away.

    Args:
        part: of the distance, half the side of the square over which it is the mean.
    """
    largest, _, asset, file = desk_lamp
    c, gamma = np.deg2rad([limit.c, limit.gamma])
    axis = np.array([np.sin(gamma) * np.cos(c), -np.cos(gamma), -np.sin(gamma) * np.sin(c)])
    point, side = tuple((5 * largest * axis).tolist()), max(10 * largest * part, 1e-4)
    return lux(asset, point, side), lux(file, point, side)


@pytest.mark.slow
def test_a_desk_lamp_and_its_file_agree_from_five_times_the_opening(desk_lamp):
    lit = [each for each in desk_lamp[1] if each.c != SHADED]
    assert len(lit) == len(desk_lamp[1]) - 1
    for limit in lit:
        of_asset, of_file = lux_of_both(desk_lamp, limit)
        assert of_file == pytest.approx(of_asset, rel=0.05)


@pytest.mark.slow
def test_a_desk_lamp_and_its_file_agree_where_its_foot_throws_a_shadow(desk_lamp):
    """The light of the file is blurred by the step of its angles: means over 23 degrees agree."""
    (shaded,) = [each for each in desk_lamp[1] if each.c == SHADED]
    of_asset, of_file = lux_of_both(desk_lamp, shaded, part=0.2)
    assert of_file == pytest.approx(of_asset, rel=0.05)
