"""Illuminance of photometric files in rooms: lumitree against Radiance."""

import importlib.util

import numpy as np
import pytest

import lumitree
from benchmarks.radiance_rooms.program import Radiance
from benchmarks.radiance_rooms.rooms import furniture, mitsuba_scene, radiance_text, walls
from support.ies_text import ies_text

needs_radiance = pytest.mark.skipif(
    importlib.util.find_spec("pyradiance") is None, reason="pyradiance is not installed"
)
GAMMA = np.arange(0, 95, 5.0)
# Symmetric about C = 0 and C = 90 in one file, of no symmetry in the other.
QUADRANT, ROUND = np.arange(0, 91, 22.5), np.arange(0, 361, 15.0)
# In the frame of the room, y up: on a plane, and at two walls.
POINTS = np.array(
    [(x, 0.85, z) for x in (-1.6, -0.3, 0.9) for z in (-1.1, 0.5)]
    + [(-1.99, 1.2, 0.3), (0.4, 1.0, 1.49)]
)
NORMALS = np.array([(0, 1, 0)] * 6 + [(1, 0, 0), (0, 0, -1)], float)


def lamp(kind):
    """Text of an IES file."""
    cosine = np.cos(np.deg2rad(GAMMA))
    sine = np.sin(np.deg2rad(GAMMA))
    if kind == "panel":
        c = np.deg2rad(QUADRANT)[:, None]
        intensity = 500 * cosine * (1 + sine**2 * (1 - 0.5 * np.cos(2 * c)))
        return ies_text(intensity, QUADRANT, GAMMA, (0.3, 1.2, 0))
    c = np.deg2rad(ROUND)[:, None]
    return ies_text(800 * cosine**2 * (1 + 0.5 * sine * np.cos(c - 0.7)), ROUND, GAMMA)


def both(folder, kind, boxes, bounces, error, **options):
    """Illuminance of the points by lumitree and by Radiance."""
    file = folder / f"{kind}.ies"
    file.write_text(lamp(kind))
    at = (0.3, 2.4, -0.2)
    ours = lumitree.illuminance(
        mitsuba_scene(boxes),
        [lumitree.Placement(file, at=at)],
        points=POINTS,
        normals=NORMALS,
        error=error,
        direct=bounces == 0,
    )
    program = Radiance(folder)
    scene = radiance_text(boxes) + program.photometric_source(file, at)
    return ours, program.illuminance(scene, POINTS, NORMALS, bounces, **options)


def agree(ours, error, theirs):
    """Each point within 2 %, with errors that are small enough to tell."""
    noise = np.hypot(error, theirs.error)
    assert (noise < 0.006 * theirs.lux).all()
    assert ours == pytest.approx(theirs.lux, rel=0.02)
    assert ours.mean() == pytest.approx(theirs.lux.mean(), rel=0.01)


@needs_radiance
@pytest.mark.parametrize("kind", ["point", "panel"])
def test_direct_illuminance_is_that_of_radiance(mi, tmp_path, kind):
    ours, theirs = both(tmp_path, kind, walls(0.3, 0.5, 0.7), 0, 0.003)
    agree(ours.direct, ours.direct_error, theirs)


@needs_radiance
@pytest.mark.slow
@pytest.mark.parametrize("kind", ["point", "panel"])
def test_the_illuminance_in_a_furnished_room_is_that_of_radiance(mi, tmp_path, kind):
    boxes = walls(0.3, 0.5, 0.7) + furniture()
    ours, theirs = both(tmp_path, kind, boxes, 24, 0.004, divisions=512, repeats=12)
    agree(ours.total, ours.total_error, theirs)
