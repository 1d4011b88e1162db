"""A lamp in centimetres and the same one in metres are one lamp in other programs."""

import dataclasses

import numpy as np
import pytest

import lumitree
from lumitree.asset.geometry import Medium
from lumitree.rendering.asset_flux import asset_lumens
from support.geometry_assets import small_geometry, with_geometry

pytestmark = pytest.mark.usefixtures("mi")


@pytest.fixture
def lamp():
    *others, sphere = small_geometry().shapes
    inside, outside = Medium((2.0, 20.0, 70.0)), Medium((1.0, 2.0, 3.0), (4.0, 5.0, 6.0), 0.5)
    sphere = dataclasses.replace(sphere, interior=inside, exterior=outside)
    return with_geometry(small_geometry(shapes=(*others, sphere)))


def test_a_factor_there_and_back_changes_nothing(lamp):
    large = lamp.scaled(100)
    assert large.frame.size == pytest.approx(100 * lamp.frame.size)
    assert asset_lumens(large) == pytest.approx(1e4 * asset_lumens(lamp))
    exterior = large.geometry.shapes[2].exterior
    assert exterior.scattering == pytest.approx([0.04, 0.05, 0.06])
    assert exterior.anisotropy == 0.5
    again = large.scaled(0.01)
    np.testing.assert_allclose(again.frame.world_from_local, lamp.frame.world_from_local)
    np.testing.assert_allclose(again.geometry.vertices, lamp.geometry.vertices, rtol=1e-6)
    assert again.geometry.shapes[2].interior.absorption == pytest.approx([2.0, 20, 70])


def test_other_units_are_refused(lamp, tmp_path):
    with pytest.raises(lumitree.LumitreeError, match="unit is 'yard'; expected m, cm"):
        lumitree.export(lamp, tmp_path / "lamp.rad", unit="yard")
