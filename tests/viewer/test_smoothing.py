"""Surfaces of the page have no noise, and the radiance of Mitsuba."""

import numpy as np
import pytest

from lumitree.asset.geometry import UnitShape
from lumitree.asset.geometry_file import read_material
from lumitree.asset.materials import Diffuse
from lumitree.core.frames import LocalFrame
from support.geometry_assets import NOTHING, matrix, small_geometry, with_geometry

PLASTIC = {
    "type": "roughplastic", "alpha": 0.05, "distribution": "ggx", "int_ior": 1.5, "ext_ior": 1.0,
    "nonlinear": True, "diffuse_reflectance": [0.029, 0.029, 0.029],
}  # fmt: skip
HEIGHT, SIDE, RADIUS, RADIANCE = 0.9, 0.3, 0.03, 100.0


def plate_below_a_bulb():
    """A plate of black plastic at y = -0.5, 0.9 below an emissive sphere."""
    bulb = np.diag([RADIUS, RADIUS, RADIUS, 1.0])
    bulb[1, 3] = HEIGHT - 0.5
    plate = np.array([[SIDE, 0, 0, 0], [0, 0, 1, -0.5], [0, -SIDE, 0, 0], [0, 0, 0, 1]])
    shapes = (
        UnitShape(type="sphere", to_world=matrix(bulb), material=1, radiance=RADIANCE),
        UnitShape(type="rectangle", to_world=matrix(plate), material=0),
    )
    materials = (read_material(PLASTIC), Diffuse(reflectance=0.0))
    geometry = small_geometry(shapes=shapes, materials=materials, **NOTHING)
    return with_geometry(geometry, LocalFrame(np.ones(3), np.eye(4)))


def sent_out(model):
    """Radiance [V] of the green channel of fronts."""
    codes = model.arrays["light"].astype(np.float64)[:, 1]
    a_stop, zero = model.description["codes"][2:4]
    return (
        np.where(codes > 0, 2 ** ((codes - zero) / a_stop), 0) * model.description["max_radiance"]
    )


def albedo(mi, cosine):
    """Part of the light from a direction that the plastic reflects: mean of its samples."""
    import drjit as dr

    count = 1 << 18
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(0, count)
    si = dr.zeros(mi.SurfaceInteraction3f, count)
    si.wi = mi.Vector3f(float(np.sqrt(1 - cosine**2)), 0, float(cosine))
    bsdf = mi.load_dict({**PLASTIC, "diffuse_reflectance": {"type": "rgb", "value": 0.029}})
    return float(
        dr.mean(bsdf.sample(mi.BSDFContext(), si, sampler.next_1d(), sampler.next_2d())[1].y)[0]
    )


def test_black_plastic_is_smooth(mi):
    from lumitree.viewer.model import page_model

    model = page_model(plate_below_a_bulb())
    positions = 2 * model.arrays["positions"] / (model.description["codes"][0] - 1) - 1
    triangles, light = model.arrays["triangles"], sent_out(model)
    corners = positions[triangles]
    plate = triangles[np.abs(corners[..., 1] + 0.5).max(axis=1) < 1e-3]
    sides = np.concatenate([plate[:, :2], plate[:, 1:], plate[:, [2, 0]]])
    differences = np.abs(np.diff(light[sides], axis=1)[:, 0]) / light[sides].mean(axis=1)
    vertices = np.unique(plate)
    # Irradiance of a sphere above the horizon: pi L (r / d)² cos θ.
    distance = np.linalg.norm(positions[vertices] - [0, HEIGHT - 0.5, 0], axis=1)
    cosine = HEIGHT / distance
    table = np.linspace(0.8, 1, 9)
    reflected = np.interp(cosine, table, [albedo(mi, each) for each in table])
    expected = reflected * RADIANCE * (RADIUS / distance) ** 2 * cosine
    # The irradiance itself differs by up to 2 % from vertex to vertex.
    assert differences.mean() < 0.03
    assert differences.max() < 0.15
    assert light[vertices].mean() == pytest.approx(expected.mean(), rel=0.03)


def test_light_stays_on_connected_vertices(mi):
    """Noise of a few vertices spreads, a step between parts that are not connected stays."""
    from lumitree.viewer.triangles import smoothed

    count = 20
    place = np.linspace(-0.5, 0.5, count + 1)
    vertices = np.stack(np.meshgrid(place, [0.0], place), axis=-1).reshape(-1, 3)
    corner = (np.arange(count)[:, None] * (count + 1) + np.arange(count)).ravel()
    faces = np.stack([corner, corner + 1, corner + count + 2], axis=1)
    faces = np.concatenate(
        [faces, np.stack([corner, corner + count + 2, corner + count + 1], axis=1)]
    )
    above = np.array([0, 0.01, 0])
    both = np.concatenate([vertices, vertices + above])
    faces = np.concatenate([faces, faces + len(vertices)])
    random = np.random.default_rng(0)
    paths = np.full(len(both), 8.0)
    level = np.repeat([1.0, 5.0], len(vertices))
    spread = 4.0
    values = level[:, None] * random.gamma(8 / spread, spread / 8, (len(both), 3))
    variance = (spread * level**2).astype(np.float32)
    found = smoothed(values.astype(np.float32), variance, paths, both, faces)
    for part in (slice(0, len(vertices)), slice(len(vertices), None)):
        error = found[part] / level[part, None] - 1
        noise = values[part] / level[part, None] - 1
        assert np.sqrt((error**2).mean()) < 0.4 * np.sqrt((noise**2).mean())
        weight = np.bincount(faces.ravel(), np.ones(faces.size), len(both))[part]
        kept = np.average(found[part], axis=0, weights=weight)
        np.testing.assert_allclose(
            kept, np.average(values[part], axis=0, weights=weight), rtol=0.01
        )
    # Exact values are left as they are.
    exact = np.tile(np.sin(9 * both[:, :1]) + 2, (1, 3)).astype(np.float32)
    same = smoothed(exact, np.zeros(len(both), np.float32), paths, both, faces)
    np.testing.assert_allclose(same, exact, rtol=1e-4)
