"""The field that the page shows of a light field has the radiance of that light."""

import dataclasses

import numpy as np
import pytest

from lumitree.asset.asset import light_field_asset
from lumitree.asset.light_field import make_light_field
from lumitree.core.device import on_device
from lumitree.core.frames import LocalFrame, similarity
from lumitree.core.harmonics import MAX_L, basis_array
from lumitree.core.octahedral import middle_directions, solid_angles
from lumitree.octree.build import leaf_cells
from lumitree.viewer.light_as_field import (
    DEFAULT_VIEW,
    DENSITY,
    brightest_view,
    light_as_field,
)

SPOT = np.array([0.3, -0.9, 0.2]) / np.linalg.norm([0.3, -0.9, 0.2])


def spot_asset(half_extents=(1, 0.6, 0.8), power=3, depth=2, resolution=32, scale=0.2, gain=None):
    """Some cells with light about one direction, of another colour and amount each."""
    random = np.random.default_rng(0)
    side = 2**depth
    cells = np.indices((side, side, side)).reshape(3, -1).T
    inside = np.abs((2 * cells + 1) / side - 1) - 1 / side < half_extents
    cells = cells[inside.all(axis=1)][::3]
    shape = np.maximum(middle_directions(resolution) @ SPOT, 0) ** power
    colour = random.uniform(0.2, 1, (len(cells), 1, 3))
    light_field = make_light_field(cells, colour * (shape[:, None] + 0.05), depth)
    asset = light_field_asset(
        light_field, LocalFrame(half_extents, similarity(np.eye(3), scale)), "spot"
    )
    return asset if gain is None else dataclasses.replace(asset, light_factors=gain)


def rays_of_images(half_extents, count, towards):
    """Rays as of the pixels of images, at most 75 degrees from a direction of light."""
    random = np.random.default_rng(1)
    direction = random.normal(size=(16 * count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    # They travel to the lamp, so their light comes the other way.
    direction = direction[-direction @ towards > 0.25][:count]
    aside = np.cross(direction, random.normal(size=(count, 3)))
    aside *= np.sqrt(random.random((count, 1))) / np.linalg.norm(aside, axis=1, keepdims=True)
    return np.linalg.norm(half_extents) * aside - 4 * direction, direction


@pytest.mark.parametrize("half_extents", [(1, 0.6, 0.8), (0.7, 1e-3, 1)])
@pytest.mark.parametrize("gain", [(1.0, 1.0, 1.0), (0.5, 2.0, 1.0)])
def test_radiance_is_that_of_the_light_field(mi, half_extents, gain):
    from lumitree.rendering.device import DeviceAsset

    asset = spot_asset(half_extents, gain=gain)
    origin, direction = rays_of_images(half_extents, 4000, SPOT)
    light, many = DeviceAsset(asset).light, 64
    # The light of a bin at random, by the bits of the direction: the mean of directions nearby.
    near = np.repeat(direction, many, axis=0)
    near += 1e-5 * np.random.default_rng(0).normal(size=near.shape)
    points = on_device(mi.Point3f, np.repeat(origin, many, axis=0))
    directions = on_device(mi.Vector3f, near / np.linalg.norm(near, axis=1, keepdims=True))
    expected = np.array(light.eval(points, points, directions)[0], np.float64)
    expected = expected.reshape(3, -1, many).mean(axis=2).T
    found, transmittance = light_as_field(asset).eval(asset.frame.scale * origin, direction)
    assert (expected.max(axis=1) > 0).mean() > 0.05
    # No light where there are no cells, and the same light elsewhere.
    assert found[expected.max(axis=1) == 0].max() == 0
    assert found.mean(axis=0) == pytest.approx(expected.mean(axis=0), rel=0.02)
    assert np.abs(found - expected).mean() < 0.08 * expected.mean()
    assert transmittance.min() > 1 - 2 * np.sqrt(3) * DENSITY


def test_all_else_of_the_asset_stays(mi):
    asset = spot_asset(gain=(0.5, 2.0, 1.0))
    shown = light_as_field(asset)
    cells, levels = leaf_cells(shown.children, shown.num_leaves)
    assert np.array_equal(cells, asset.light_field.cells)
    assert set(levels) == {asset.light_field.depth}
    assert shown.light_field is asset.light_field
    assert (shown.light_factors, shown.frame, shown.luminaire) == (
        asset.light_factors,
        asset.frame,
        "spot",
    )


@pytest.mark.parametrize("resolution", [4, 32, 128])
def test_light_in_single_bins_keeps_its_flux(mi, resolution):
    """As of a histogram of few paths: no rows are singular, and dark channels stay dark."""
    intensity = np.zeros((2, resolution**2, 3))
    intensity[0, 5] = [1, 0, 0.1]
    intensity[1, -1] = [0, 1e-6, 0]
    light_field = make_light_field(np.array([[0, 0, 0], [1, 1, 1]]), intensity, 1)
    shown = light_as_field(light_field_asset(light_field, LocalFrame((1, 1, 1), np.eye(4)), "lamp"))
    logit = np.einsum("mck,bk->mcb", shown.coefficients, basis_array(middle_directions(16), MAX_L))
    # Cells of a volume of 1.
    found = shown.max_radiance * DENSITY / (1 + np.exp(-logit)) @ solid_angles(16)
    expected = np.einsum("mbc,b->mc", intensity, solid_angles(resolution))
    assert found == pytest.approx(expected, rel=0.1, abs=1e-12)


def test_the_first_view_is_one_that_light_goes_to(mi):
    yaw, pitch = brightest_view(spot_asset())
    assert yaw == pytest.approx(np.arctan2(SPOT[0], SPOT[2]), abs=0.05)
    assert pitch == -1
    everywhere = make_light_field(np.zeros((1, 3), int), np.ones((1, 32**2, 3)), 1)
    asset = light_field_asset(everywhere, LocalFrame((1, 1, 1), np.eye(4)), "lamp")
    assert brightest_view(asset) == DEFAULT_VIEW
