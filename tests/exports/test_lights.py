"""Point lights have the flux of the field and nearly its irradiance, as tables and as spots too."""

import dataclasses

import numpy as np
import pytest

import lumitree
from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import make_light_field, unpack
from lumitree.cli import main
from lumitree.core.frames import LocalFrame, rotation
from lumitree.core.octahedral import middle_directions, solid_angles
from lumitree.errors import LumitreeError
from support.light_fields import random_light_field

pytestmark = pytest.mark.usefixtures("mi")


def lights_of(field, count, half=(1, 1, 1), seed=0):
    from lumitree.exports.point_lights import cluster_lights

    return cluster_lights(field, np.array(half, float), count, seed)


@pytest.mark.parametrize("count", [1, 3, 40])
def test_each_direction_keeps_its_intensity(count):
    field = random_light_field(1, depth=4, resolution=8, count=30)
    lights = lights_of(field, count)
    expected = field.scale * np.stack(
        [field.dense(channel).sum(axis=0) for channel in unpack(field.intensity).T], axis=-1
    )
    assert len(lights.position) == min(count, 30)
    np.testing.assert_allclose(lights.intensity.sum(axis=0), expected, rtol=1e-12)
    total = np.einsum("bc,b->c", expected, solid_angles(8))
    np.testing.assert_allclose(lights.flux.sum(axis=0), total, rtol=1e-12)


def test_as_many_lights_as_cells_stand_in_them():
    half = np.array([1, 0.3, 1])
    field = random_light_field(2, depth=2, count=20)
    lights = lights_of(field, 20, half)
    lower = np.clip(field.cells / 2 - 1, -half, half)
    upper = np.clip((field.cells + 1) / 2 - 1, -half, half)
    np.testing.assert_allclose(lights.position, (lower + upper) / 2, atol=1e-12)


def test_a_light_stands_at_the_centroid_of_flux():
    intensity = np.ones((2, 16, 3)) * np.array([3.0, 1.0])[:, None, None]
    cells = np.array([[0, 0, 0], [3, 0, 0]])
    lights = lights_of(make_light_field(cells, intensity, 2), 1)
    expected = [[0.75 * -0.75 + 0.25 * 0.75, -0.75, -0.75]]
    # Intensities are stored to 0.2 %.
    np.testing.assert_allclose(lights.position, expected, atol=2e-3)


def test_clusters_are_those_of_scipy():
    from scipy.cluster.vq import kmeans2

    from lumitree.exports.point_lights import cluster_points

    points = np.random.default_rng(1).normal(size=(3000, 3))
    for count in (1, 2, 30):
        expected, _ = kmeans2(points, count, 20, minit="++", rng=np.random.default_rng(5))
        found = cluster_points(points, count, np.random.default_rng(5))
        np.testing.assert_allclose(found, expected, rtol=1e-9)


def test_there_are_no_more_clusters_than_different_points():
    from lumitree.exports.point_lights import cluster_points

    points = np.repeat(np.eye(3), 50, axis=0)
    found = cluster_points(points, 10, np.random.default_rng(2))
    assert sorted(found.tolist()) == np.eye(3)[::-1].tolist()


def test_lights_that_a_gain_makes_black_are_left_out():
    from lumitree.exports.point_lights import place_lights

    intensity = np.zeros((2, 16, 3))
    intensity[0, :, 0] = intensity[1, :, 2] = 1
    field = make_light_field(np.array([[0, 0, 0], [3, 0, 0]]), intensity, 2)
    asset = light_field_asset(field, LocalFrame(np.ones(3), np.eye(4)), "red and blue")
    red = place_lights(dataclasses.replace(asset, light_factors=(2.0, 1.0, 0.0)), np.eye(3), 2)
    np.testing.assert_allclose(red.position, [[-0.75, -0.75, -0.75]])
    np.testing.assert_allclose(red.watts, [[8 * np.pi, 0, 0]], rtol=1e-2)
    with pytest.raises(LumitreeError, match="sends no light"):
        place_lights(dataclasses.replace(asset, light_factors=(0.0, 1.0, 0.0)), np.eye(3), 2)


RESOLUTION = 16


def downlight():
    """A downlight with a shade, one cell of which emits evenly; y up."""
    directions = middle_directions(RESOLUTION)
    down = np.maximum(-directions[:, 1], 0)
    intensity = np.zeros((2, RESOLUTION**2, 3))
    intensity[0] = (down * (down > 0.5))[:, None] * [1.0, 0.8, 0.5]
    intensity[1] = 0.02
    field = make_light_field(np.array([[1, 0, 1], [0, 1, 0]]), intensity, 1)
    frame = LocalFrame(np.ones(3), np.eye(4))
    return light_field_asset(field, frame, "downlight")


def irradiance(directions, intensity):
    """Sums over directions of intensity times cosine [16], to 16 sides; 0 where it is dark."""
    cosine = np.maximum(directions @ middle_directions(4).T, 0)
    return intensity @ (cosine * solid_angles(RESOLUTION)[:, None])


def test_spots_have_flux_and_illumination_of_the_lights():
    from lumitree.exports.light_profiles import spots_of
    from lumitree.exports.point_lights import place_lights, turn_up

    placed = place_lights(downlight(), turn_up("z", "y"), 2)
    directions = middle_directions(RESOLUTION) @ placed.rotation.T
    local = placed.local.intensity.sum(axis=0) @ [0.2126, 0.7152, 0.0722]
    expected = local * placed.scale**2
    found, flux = np.zeros(len(directions)), 0.0
    for spot in spots_of(placed):
        border = np.cos(np.radians(spot.half_angle))
        place = np.clip((directions @ spot.axis - border) / (1 - border), 0, 1)
        luminance = spot.candela / 683 * np.dot(spot.colour, [0.2126, 0.7152, 0.0722])
        flux += luminance * np.pi * (1 - border)
        found += luminance * (3 * place**2 - 2 * place**3)
        x, y, _, w = spot.rotation
        # The quaternion turns -z to the axis.
        np.testing.assert_allclose(
            [-2 * w * y, 2 * w * x, 2 * (x**2 + y**2) - 1], spot.axis, atol=1e-6
        )
    weight = solid_angles(RESOLUTION)
    assert flux == pytest.approx(expected @ weight, rel=1e-6)
    wanted = irradiance(directions, expected)
    lit = wanted > 0.1 * wanted.max()
    np.testing.assert_allclose(irradiance(directions, found)[lit], wanted[lit], rtol=0.04)


def test_exports_say_that_blender_makes_other_light_of_them(tmp_path, capsys):
    lumitree.save(downlight(), tmp_path / "lamp.lumitree")
    arguments = ["export", str(tmp_path / "lamp.lumitree"), "-o", str(tmp_path / "lamp.glb")]
    assert main(arguments) == 0
    assert "note: Blender's importer makes other light of it" in capsys.readouterr().out
    assert main([*arguments, "--importer", "blender"]) == 0
    assert "makes other light" not in capsys.readouterr().out
    with pytest.raises(
        lumitree.LumitreeError, match=r"for .glb, .usda and .usdz, and the output is for Radiance"
    ):
        lumitree.export(downlight(), tmp_path / "lamp.rad", importer="blender")


def test_weights_of_a_table_are_those_of_linear_interpolation():
    from lumitree.exports.blender import table_angles

    weight = table_angles(16)
    assert 32 * weight.sum() == pytest.approx(4 * np.pi)
    np.testing.assert_allclose(weight, weight[::-1])
    # A hat of a row of another grid integrated by the midpoint rule.
    latitude = (np.arange(200_000) + 0.5) / 200_000 * np.pi - np.pi / 2
    row = (latitude / np.pi + 0.5) * 16 - 0.5
    hat = np.maximum(0, 1 - np.abs(row - 5))
    assert weight[5] == pytest.approx(
        (hat * np.cos(latitude)).mean() * np.pi * (2 * np.pi / 32), rel=1e-4
    )


def test_tables_hold_the_intensity_of_their_directions_and_its_flux():
    from lumitree.exports.blender import direction_tables, table_angles
    from lumitree.exports.blender import table_directions as directions
    from lumitree.exports.point_lights import PointLights

    turn = rotation([1, 2, 3], 40.0)
    coarse = 32
    mi = pytest.importorskip("mitsuba")
    from lumitree.core.octahedral import direction_in_bin

    bins = mi.UInt32(np.arange(coarse**2, dtype=np.uint32))
    centre = np.array(direction_in_bin(bins, mi.Point2f(0.5), coarse)[0], np.float64).T
    smooth = 2 + centre @ np.array([[1.0, 0, 0], [0, -1, 0.5], [0.3, 0, 1]])
    lights = PointLights(np.zeros((1, 3)), smooth[None])
    tables = direction_tables(lights, turn, 64)
    local = directions(64) @ turn.T
    expected = 2 + local @ np.array([[1.0, 0, 0], [0, -1, 0.5], [0.3, 0, 1]])
    assert np.abs(tables[0] - expected).max() < 0.12
    np.testing.assert_allclose(
        np.einsum("shwc,h->sc", tables, table_angles(64)), lights.flux, rtol=1e-12
    )
