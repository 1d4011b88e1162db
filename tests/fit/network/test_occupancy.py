"""The visual hull and the ray set built with it."""

import jax
import numpy as np
import pytest

from lumitree.core.frames import orthographic_rays, view_pose
from lumitree.errors import LumitreeError
from lumitree.fit.network.rays import (
    Occupancy,
    contains,
    dilated_hull,
    full_occupancy,
    load_rays,
)
from support.sphere import CENTRE, HALF_EXTENTS, HALF_WIDTH, RADIUS, hit_distance, sphere_dataset


def _sphere_points(radius, count=20_000):
    points = np.random.default_rng(0).normal(size=(count, 3))
    points *= radius / np.linalg.norm(points, axis=-1, keepdims=True)
    return (points + CENTRE).astype(np.float32)


def _in_box(points):
    return np.all(np.abs(points) <= np.array(HALF_EXTENTS), axis=-1)


def test_hull_keeps_the_object_and_carves_the_rest(tmp_path):
    dataset = sphere_dataset(tmp_path, views=16, resolution=64)
    hull = dilated_hull(
        ((view.frame.pose, view.geometric > 0) for view in dataset.views()),
        HALF_WIDTH,
        HALF_EXTENTS,
        resolution=64,
    )
    for radius in (0.2, RADIUS):
        assert np.asarray(contains(hull, _sphere_points(radius))).all()
    # A pixel is 0.047, a cell 0.031: well outside of the sphere it must be empty.
    outside = _sphere_points(1.35 * RADIUS)
    outside = outside[_in_box(outside)]
    assert len(outside) > 1000
    assert np.asarray(contains(hull, outside)).mean() < 0.02


def test_no_hit_is_ever_carved(tmp_path):
    """Also for views and pixels so few that footprints and pixels hardly overlap."""
    for resolution, views in ((7, 5), (33, 3)):
        folder = tmp_path / str(resolution)
        dataset = sphere_dataset(folder, views, resolution)
        hull = dilated_hull(
            ((view.frame.pose, view.geometric > 0) for view in dataset.views()),
            HALF_WIDTH,
            HALF_EXTENTS,
            resolution=64,
        )
        for frame in dataset.manifest.frames:
            origins, direction = orthographic_rays(frame.pose, HALF_WIDTH, resolution)
            distance = hit_distance(origins, direction)
            points = (origins + distance[..., None] * direction)[np.isfinite(distance)]
            assert np.asarray(contains(hull, points.astype(np.float32))).all()


def test_what_a_view_does_not_show_is_kept():
    pose = view_pose(1, 2.0)
    # The view covers a quarter of the box's width only, and shows nothing there.
    hull = dilated_hull([(pose, np.zeros((16, 16), bool))], 0.25, (1.0, 1.0, 1.0), resolution=32)
    assert not hull.cells[16, 16, 16]
    assert np.asarray(hull.cells).mean() > 0.8


def test_occupancy_round_trip():
    cells = np.random.default_rng(0).random((5, 7, 3)) < 0.5
    saved = full_occupancy((1.0, 0.5, 0.2))._replace(cells=cells)
    loaded = Occupancy.of_arrays(saved.arrays())
    np.testing.assert_array_equal(loaded.cells, cells)
    np.testing.assert_array_equal(loaded.half_extents, saved.half_extents)


def test_dropped_rays_are_background(tmp_path):
    dataset = sphere_dataset(tmp_path, views=6, resolution=32)
    everything, _ = load_rays(dataset, "geometric", skip_empty=False)
    kept, _ = load_rays(dataset, "geometric", skip_empty=True)
    assert len(kept.view) < 0.6 * len(everything.view)
    assert (kept.opacity > 0).sum() == (everything.opacity > 0).sum() > 0
    assert kept.radiance.sum() == everything.radiance.sum()


def test_batches_are_the_captured_rays(tmp_path):
    dataset = sphere_dataset(tmp_path, views=4, resolution=16)
    rays, _ = load_rays(dataset, "straight_through", skip_empty=False)
    batch = jax.device_get(rays.batch(np.arange(len(rays.view))))
    for origin, direction, radiance, opacity in zip(*batch, strict=True):
        hit = np.isfinite(hit_distance(origin, direction))
        assert hit == (opacity == 1)
        assert hit == (radiance[0] > 0)
    first = orthographic_rays(dataset.manifest.frames[0].pose, HALF_WIDTH, 16)[0].reshape(-1, 3)
    of_first = rays.view == 0
    np.testing.assert_allclose(batch.origins[of_first], first[rays.pixel[of_first]], atol=1e-6)


def test_held_out_rays_are_never_drawn(tmp_path):
    rays, _ = load_rays(sphere_dataset(tmp_path, 4, 16), "geometric", skip_empty=False)
    held = {tuple(row) for row in np.asarray(rays.held_out().origins)}
    drawn = {tuple(row) for row in np.asarray(rays.draw(0, 0, 20_000).origins)}
    assert held
    assert not held & drawn
    assert len(held) + len(drawn) == len(rays.view)
    np.testing.assert_array_equal(rays.draw(1, 2, 8).opacity, rays.draw(1, 2, 8).opacity)
    assert (rays.draw(1, 2, 50).origins != rays.draw(1, 3, 50).origins).any()


def test_max_radiance_clips_fireflies(tmp_path):
    dataset = sphere_dataset(tmp_path, views=6, resolution=64)
    view = next(dataset.views())
    view.radiance[32, 32] = 1e6
    dataset.write(view)
    rays, _ = load_rays(dataset, "geometric", skip_empty=False)
    assert 3.5 < rays.max_radiance < 10
    assert rays.radiance.max() == np.float32(rays.max_radiance)
    # Channels of 0.2 to 4, a half and a quarter of it: about 1 of 4.
    assert 0.15 < rays.typical_part < 0.4


def test_black_dataset_is_refused(tmp_path):
    with pytest.raises(LumitreeError, match=r"every view of .* is black"):
        load_rays(sphere_dataset(tmp_path, 2, 8, brightness=0.0), "geometric", skip_empty=True)
