"""The room of the benchmark `blender`: which pixels show which wall, and their statistics."""

import numpy as np
import pytest

from benchmarks.cycles.room import CAMERA, LAMP_CENTRE, WALLS, region_masks


def test_masks_are_the_walls_that_mitsuba_shows(mi):
    from benchmarks.cycles.room import mitsuba_room

    width, height, half = 64, 48, np.array([0.3, 0.2, 0.3])
    room = mitsuba_room(width, height)
    integrator = mi.load_dict({"type": "aov", "aovs": "position:position,normal:sh_normal"})
    image = np.array(mi.render(room, integrator=integrator, spp=1, seed=0))[..., -6:]
    position, normal = image[..., :3], image[..., 3:]
    masks = region_masks(width, height, half)
    assert not np.logical_and.reduce(list(masks.values())).any()
    for name, mask in masks.items():
        wall = WALLS[name]
        inwards = np.cross(wall["first"], wall["second"])
        inwards = inwards / np.linalg.norm(inwards)
        assert mask.sum() > 100
        # A pixel at an edge may show two walls.
        assert (np.abs(normal[mask] - inwards) < 1e-4).all(axis=-1).mean() > 0.99
        # The straight lines to the camera pass the lamp's box at a distance.
        steps = np.linspace(0, 1, 200)[:, None, None]
        points = np.array(CAMERA["origin"]) + steps * (position[mask] - CAMERA["origin"])
        assert (np.abs(points - LAMP_CENTRE) > half).any(axis=-1).all()


def test_statistics_are_those_of_independent_noise():
    from benchmarks.blender import _statistics

    pixels = np.random.default_rng(1).normal(2, 0.5, (8, 5000))
    found = _statistics(pixels)
    assert found["mean"] == pytest.approx(2, abs=0.02)
    assert found["noise"] == pytest.approx(0.25, rel=0.05)
    assert found["mean_error"] == pytest.approx(0.5 / np.sqrt(8 * 5000), rel=0.8)


def test_tables_have_a_line_for_each_row():
    from benchmarks.blender import METHODS, irradiance_table, room_table

    walls = {"floor": {"mean": 2.0, "mean_error": 0.1, "noise": 0.3}}
    common = {"luminaire": "x", "samples": 4, "seconds": 1.0, "cpu_seconds": 2.0, "walls": walls}
    text = room_table([{**common, "method": method} for method in METHODS]).markdown()
    assert text.count("1.000 ± 0.050") == len(METHODS)
    row = {
        "luminaire": "x", "lights": "4", "smallest_ratio": 0.9, "largest_ratio": 1.1, "rms": 0.05,
        "rms_touching": 0.2, "rms_touching_error": 0.01,
    }  # fmt: skip
    assert "0.900 to 1.100 | 5.0% | 20.0% ± 1.0%" in irradiance_table([row]).markdown()
