"""Luminous openings: the tables of LM-63, and quadratures against closed forms."""

# pyright: reportCallIssue=false, reportArgumentType=false
import numpy as np
import pytest

from lumitree.errors import LumitreeError
from lumitree.formats.opening import Opening, lm63_dimensions, lm63_opening

DISK = {"shape": "cylinder", "axis": 1}
SPHERE = {"shape": "ellipsoid"}
# Width, length, height: sides along x (length), y and z (width), and shape.
SHARED = [
    ((0, 0, 0), (0, 0, 0), {}),
    ((2, 3, 0), (3, 0, 2), {}),
    ((2, 3, 4), (3, 4, 2), {}),
    ((-2, 0, 0), (2, 0, 2), DISK),
    ((0, -2, 0), (2, 0, 2), DISK),
    ((-2, -2, 0), (2, 0, 2), DISK),
    ((-2, 0, 5), (2, 5, 2), DISK),
    ((-2, -3, 5), (3, 5, 2), DISK),
    ((-2, 3, 0), (3, 0, 2), DISK),
    ((2, -3, 0), (3, 0, 2), DISK),
    ((-2, -2, -2), (2, 2, 2), SPHERE),
    ((0, 3, -2), (3, 2, 2), {"shape": "cylinder", "axis": 0}),
    ((3, 0, -2), (2, 2, 3), {"shape": "cylinder", "axis": 2}),
]
UNTIL_1995 = [
    ((-2, 0, -2), (2, 2, 2), SPHERE),
    ((-2, 3, -4), (3, 4, 2), SPHERE),
    ((2, -3, -4), (3, 4, 2), SPHERE),
]
SINCE_2002 = [
    ((-2, 0, -2), (0, 2, 2), {"shape": "cylinder", "axis": 0}),
    ((-2, 3, -2), (3, 2, 2), {"shape": "cylinder", "axis": 0}),
    ((3, -2, -2), (2, 2, 3), {"shape": "cylinder", "axis": 2}),
]


@pytest.mark.parametrize(
    ("year", "table"),
    [(year, SHARED) for year in (1986, 1991, 1995, 2002, 2019)]
    + [(1986, UNTIL_1995), (1995, UNTIL_1995), (2002, SINCE_2002), (2019, SINCE_2002)],
)
def test_shapes_by_their_signs(year, table):
    for dimensions, sides, shape in table:
        assert lm63_opening(*dimensions, year) == Opening(tuple(map(float, sides)), **shape)
        feet = lm63_opening(*dimensions, year, 0.3048)
        assert feet is not None
        assert feet.sides == pytest.approx(0.3048 * np.array(sides))


def test_signs_without_a_meaning():
    assert lm63_opening(1, 1, -1, 2002) is None
    assert lm63_opening(0, 0, -1, 1995) is None


@pytest.mark.parametrize(
    "opening",
    [
        Opening((3, 4, 2)),
        Opening((3, 0, 2)),
        Opening((3, 4, 2), "ellipsoid"),
        *(Opening((3, 4, 2), "cylinder", axis) for axis in range(3)),
        Opening((2, 0, 2), "cylinder"),
        Opening((0, 2, 2), "cylinder", 0),
    ],
)
def test_written_signs_are_read_again(opening):
    assert lm63_opening(*lm63_dimensions(opening), 2019) == opening


@pytest.mark.parametrize("sides", [(-1, 0, 0), (np.nan, 1, 1), (np.inf, 1, 1), (1e7, 1, 1)])
def test_unusable_sides_are_refused(sides):
    with pytest.raises(LumitreeError, match="opening"):
        Opening(sides)


def projected(opening, direction):
    points, areas = opening.surface()
    half = np.array(opening.sides) / 2
    assert (np.abs(points) <= half + 1e-9).all()
    direction = np.array(direction) / np.linalg.norm(direction)
    facing = np.maximum(areas @ direction, 0)
    return facing.sum(), facing @ points / facing.sum()


@pytest.mark.parametrize("direction", [[0, -1, 0], [1, 0, 0], [0, 0, 1], [1, -2, 0.5]])
def test_projected_areas_are_in_proportion(direction):
    """Against closed forms, relative to the projection along y."""
    x, y, z = np.abs(direction) / np.linalg.norm(direction)
    a, b, c = 1.5, 2.0, 1.0
    sides = (2 * a, 2 * b, 2 * c)
    cases = {
        Opening(sides): (4 * (b * c * x + c * a * y + a * b * z), 4 * c * a),
        Opening(sides, "ellipsoid"): (
            np.pi * np.sqrt((b * c * x) ** 2 + (c * a * y) ** 2 + (a * b * z) ** 2),
            np.pi * c * a,
        ),
        Opening(sides, "cylinder", 1): (
            np.pi * a * c * y + 4 * b * np.sqrt((c * x) ** 2 + (a * z) ** 2),
            np.pi * c * a,
        ),
        Opening(sides, "cylinder", 0): (
            np.pi * b * c * x + 4 * a * np.sqrt((c * y) ** 2 + (b * z) ** 2),
            4 * a * c,
        ),
        Opening(sides, "cylinder", 2): (
            np.pi * a * b * z + 4 * c * np.sqrt((b * x) ** 2 + (a * y) ** 2),
            4 * a * c,
        ),
    }
    for opening, (area, below) in cases.items():
        found, centre = projected(opening, direction)
        downward, _ = projected(opening, [0, -1, 0])
        assert found / downward == pytest.approx(area / below, rel=3e-3), opening
        unit = np.array(direction) / np.linalg.norm(direction)
        assert opening.projected_area(unit) == pytest.approx(area)
        # All are convex and symmetric, so what a direction sees is in front of the centre.
        assert centre @ np.array(direction) > 0


@pytest.mark.parametrize(
    ("opening", "sides"),
    [
        # The sides of a box that face C = 0, 90, 180, 270: their width times their height.
        (Opening((3, 4, 2), heights=(4, 1, 0, 2)), (2 * 4, 3 * 1, 2 * 0, 3 * 2)),
        (Opening((3, 4, 2)), (2 * 4, 3 * 4, 2 * 4, 3 * 4)),
        # A cylinder of radius r: r ∫ h cos C dC over the half that is seen, where h is linear in
        # C from 4 at C = 0 to 0 at C = 180.
        (
            Opening((2, 4, 2), "cylinder", heights=(4, 2, 0, 2)),
            (2 * (4 - 2 * (np.pi - 2) / np.pi), 4, 2 * (2 * (np.pi - 2) / np.pi), 4),
        ),
    ],
)
def test_luminous_sides_of_different_heights(opening, sides):
    """Their projections, relative to the lower face, which stays."""
    _, height, _ = opening.sides
    below, lowest = projected(opening, [0, -1, 0])
    assert lowest[1] == pytest.approx(-height / 2)
    area = {"box": 6.0, "cylinder": np.pi}[opening.shape]
    for direction, expected in zip(
        ([1, 0, 0], [0, 0, -1], [-1, 0, 0], [0, 0, 1]), sides, strict=True
    ):
        points, areas = opening.surface()
        if opening.shape == "box":
            assert opening.projected_area(np.array(direction)) == expected
        facing = np.maximum(areas @ np.array(direction), 0)
        assert facing.sum() / below == pytest.approx(expected / area, rel=2e-2, abs=1e-12)
        if expected:
            # From the lower face up.
            assert points[facing > 0][:, 1].min() < -0.9 * height / 2
