"""`lumitree export` for pbrt-v4, read by the benchmarks: flux, directions and units."""

import numpy as np
import pytest

import lumitree
from benchmarks.exported_files.pbrt import pbrt_lights, square_of
from lumitree.core.photometry import luminance
from lumitree.rendering.asset_flux import asset_watts
from support.exported_lamps import FRAME, beam, lamp

pytestmark = pytest.mark.usefixtures("mi")


def read(path):
    lights = pbrt_lights(path)
    assert len(lights) == path.read_text().count("LightSource")
    for light in lights:
        assert light.image.shape[0] == light.image.shape[1]
    return lights


def lattice(count):
    index = np.arange(count) + 0.5
    height, angle = 1 - 2 * index / count, np.pi * (1 + 5**0.5) * index
    flat = np.sqrt(1 - height**2)
    return np.stack([flat * np.cos(angle), flat * np.sin(angle), height], axis=-1)


def test_images_hold_the_flux_in_lumens(tmp_path):
    asset = lamp()
    result = lumitree.export(asset, tmp_path / "lamp.pbrt", lights=4)
    lights = read(result.file)
    power = sum(light.power for light in lights)
    np.testing.assert_allclose(power, 683 * asset_watts(asset), rtol=1e-4)
    assert sorted(p.name for p in tmp_path.iterdir()) == ["lamp.pbrt", "lamp_files"]
    assert result.files[1:] == sorted((tmp_path / "lamp_files").iterdir())
    assert result.lights == 4
    # Random colours by direction: three lights at each point.
    assert len(lights) == 12
    assert len({tuple(light.place) for light in lights}) == 4


def test_a_light_of_one_colour_is_one_light(tmp_path, mi):
    asset = beam(mi, (0.2, 0.9, -0.1), colour=(3.0, 2.0, 1.0))
    (light,) = read(lumitree.export(asset, tmp_path / "beam.pbrt").file)
    assert luminance(light.colour) == pytest.approx(683, rel=1e-4)
    np.testing.assert_allclose(light.power, 683 * asset_watts(asset), rtol=1e-4)


@pytest.mark.parametrize(("up", "expected"), [("y", (0.2, 0.9, -0.1)), ("z", (0.2, -0.1, -0.9))])
def test_light_leaves_where_the_lamp_sends_it(tmp_path, mi, up, expected):
    (light,) = read(lumitree.export(beam(mi, (0.2, 0.9, -0.1)), tmp_path / "a.pbrt", up=up).file)
    directions = lattice(20_000)
    weight = light.intensity(directions)[:, 0]
    mean = directions.T @ weight / weight.sum()
    expected = np.array(expected) / np.linalg.norm(expected)
    # A bin is 0.22 wide, and its middle is at most 0.11 away.
    assert mean @ expected > 0.98
    # The middle of its only cell, of half the side of its box.
    place = (0.95, 1.95, 2.95) if up == "y" else (0.95, 2.95, -1.95)
    np.testing.assert_allclose(light.place, place, atol=1e-6)


def test_every_texel_is_the_mean_of_its_directions():
    """Intensities that are smooth, in a frame that is turned."""
    from lumitree.core.octahedral import middle_directions
    from lumitree.exports.pbrt import _Images
    from lumitree.exports.point_lights import PlacedLights, PointLights

    resolution = 64

    def smooth(direction):
        return 2 + direction @ np.array([[1.0, 0, 0], [0, -1, 0.5], [0.3, 0, 1]])

    local = PointLights(np.zeros((1, 3)), smooth(middle_directions(resolution))[None])
    lights = PlacedLights(np.zeros((1, 3)), local, FRAME.rotation, 2.0)
    maker = _Images(lights)
    images = maker.of(0)
    assert [image.colour.tolist() for image in images] == np.eye(3).tolist()
    directions = lattice(5000)
    column, row = (square_of(directions[:, [0, 2, 1]]) * maker.side).astype(int).T
    found = np.stack([image.watts[row, column] for image in images], axis=-1)
    expected = smooth(directions @ FRAME.rotation) * 4
    assert np.abs(found - expected).max() < 0.03 * expected.max()


def test_a_name_that_pbrt_cannot_read_is_changed(tmp_path):
    lumitree.export(lamp(), tmp_path / 'my "lamp".pbrt', lights=1)
    assert read(tmp_path / 'my "lamp".pbrt')
