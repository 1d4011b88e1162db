"""The rays of an asset."""

import numpy as np
import pytest

from lumitree.asset.asset import light_field_asset
from lumitree.core.frames import LocalFrame
from lumitree.rendering.asset_flux import AssetRays, light_field_watts
from support.fields import uniform_asset
from support.light_fields import random_light_field

COUNT = 1 << 16


def test_rays_of_an_opaque_cube_leave_it_with_its_flux(mi):
    """Surface 24, π L per area."""
    origin, direction, flux = AssetRays(uniform_asset(1e4, [3.0, 2.0, 1.0])).draw(COUNT, 1).arrays()
    assert origin.shape == direction.shape == flux.shape == (COUNT, 3)
    assert np.abs(origin).max() < 1 + 1e-5
    assert np.linalg.norm(direction, axis=1) == pytest.approx(1, abs=1e-5)
    assert flux.sum(axis=0) == pytest.approx(24 * np.pi * np.array([3, 2, 1]), rel=0.02)


def test_rays_of_an_light_field_have_its_flux(mi):
    field = random_light_field(3, depth=3, count=64)
    rays = AssetRays(light_field_asset(field, LocalFrame(np.ones(3), np.eye(4)), "random"))
    flux, again = (rays.draw(COUNT, 1).arrays()[2] for _ in range(2))
    assert np.array_equal(flux, again)
    error = flux.std(axis=0) * np.sqrt(COUNT)
    expected = light_field_watts(field)
    assert (np.abs(flux.sum(axis=0) - expected) < 5 * error + 1e-3 * expected).all()
