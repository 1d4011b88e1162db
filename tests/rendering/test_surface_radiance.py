"""Radiance that leaves the surfaces of a lamp, against exact values."""

import dataclasses

import numpy as np
import pytest

from lumitree.asset.geometry import UnitShape
from lumitree.asset.materials import Diffuse
from lumitree.core.frames import LocalFrame, rows_of
from support.geometry_assets import NOTHING, small_geometry, with_geometry


def plate_below_a_sphere(gain=(1.0, 1.0, 1.0)):
    """A grey plate at y = -0.5, seen from above, below an emissive sphere of radius 0.1 at 0."""
    plate = np.array([[1.0, 0, 0, 0], [0, 0, 1, -0.5], [0, -1, 0, 0], [0, 0, 0, 1]])
    shapes = (
        UnitShape(
            type="sphere",
            to_world=rows_of(np.diag([0.1, 0.1, 0.1, 1])),
            material=1,
            radiance=(3.0, 2, 1),
        ),
        UnitShape(type="rectangle", to_world=rows_of(plate), material=0),
    )
    materials = (Diffuse(reflectance=0.4), Diffuse(reflectance=0.0))
    geometry = small_geometry(shapes=shapes, materials=materials, **NOTHING)
    asset = with_geometry(geometry, LocalFrame(np.ones(3), np.eye(4)))
    return dataclasses.replace(asset, light_factors=gain)


def test_radiosity_of_a_plate_is_that_of_the_analytic_irradiance(mi):
    from lumitree.rendering.asset_images import vertex_radiance

    # Small triangles at the foot of the perpendicular, and at 0.5 beside it.
    small = np.array([[0, -0.5, 0], [0, -0.5, 1e-3], [1e-3, -0.5, 0]], np.float32)
    beside = small + np.array([0.5, 0, 0], np.float32)
    vertices = np.concatenate([small, beside, small + np.array([0, 0, 5], np.float32)])
    faces = np.array([[0, 1, 2], [3, 4, 5]], np.uint32)
    found, variance = vertex_radiance(plate_below_a_sphere((1.0, 2.0, 1.0)), vertices, faces, 4096)
    assert (variance[:6] > 0).all()
    # E = π L (r / d)² cos θ for a sphere above the horizon, and π B = 0.4 E.
    emitted = np.array([3.0, 4, 1])
    below = 0.4 * emitted * (0.1 / 0.5) ** 2
    np.testing.assert_allclose(found[:3].mean(axis=0), below, rtol=0.03)
    at_45_degrees = 0.4 * emitted * (0.1**2 / 0.5) * np.sqrt(0.5)
    np.testing.assert_allclose(found[3:6].mean(axis=0), at_45_degrees, rtol=0.03)
    assert not found[6:].any()


def test_an_emitter_sends_out_its_radiance_at_its_front_alone(mi):
    from lumitree.exports.surfaces import geometry_meshes, meshed
    from lumitree.rendering.asset_images import vertex_radiance

    asset = plate_below_a_sphere()
    assert asset.geometry is not None
    geometry = meshed(asset.geometry)
    asset = dataclasses.replace(asset, geometry=geometry)
    sphere = geometry_meshes(geometry, np.eye(4))[0]
    faces, count = sphere["faces"], len(sphere["vertices"])
    used = np.unique(faces)
    both = np.concatenate([sphere["vertices"]] * 2)
    found, _ = vertex_radiance(asset, both, np.concatenate([faces, faces[:, ::-1] + count]), 2)
    # A ray from the edge of a face near a pole may pass it.
    differs = np.abs(found[used] / [3, 2, 1] - 1).max(axis=1) > 1e-3
    assert differs.mean() < 1e-2
    assert found[count + used].mean() < 1e-2


@pytest.mark.slow
def test_equal_assets_have_equal_radiance(mi):
    from lumitree.rendering.asset_images import vertex_radiance

    triangle = np.array([[0, -0.5, 0], [0, -0.5, 0.1], [0.1, -0.5, 0]], np.float32)
    faces = np.array([[0, 1, 2]], np.uint32)
    runs = [vertex_radiance(plate_below_a_sphere(), triangle, faces, 64)[0] for _ in range(2)]
    assert np.array_equal(runs[0], runs[1])
    assert runs[0].min() > 0
