"""Tables of directions have the intensities of their directions, and the flux."""

import numpy as np
import pytest

from lumitree.core.frames import rotation

pytestmark = pytest.mark.usefixtures("mi")


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
