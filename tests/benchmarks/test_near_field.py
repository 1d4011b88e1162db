"""The benchmark of light inside a lamp's box: its reference, its patches, its figures."""

import numpy as np
import pytest

from benchmarks.inside_box.figures import over_planes, patch_errors
from benchmarks.inside_box.patches import NORMALS, Rectangle
from lumitree.asset.materials import Diffuse
from lumitree.core.device import on_device
from lumitree.lamp.luminaire import load_luminaire
from lumitree.lamp.materials import Material, metal
from lumitree.lamp.meshes import lathe
from lumitree.lamp.parts import Geometry, Part
from lumitree.lamp.scene_writer import write_scene

PATHS = 1 << 20
# Points of each patch from which camera paths start.
POINTS = 1 << 12
RECTANGLES = [
    Rectangle(1, -0.02, 4),
    Rectangle(1, 0.25, 4),
    Rectangle(1, 0.75, 4),
    Rectangle(0, 0.3, 4),
    Rectangle(2, 0.4, 3, part=1.0),
]


@pytest.fixture(scope="module")
def open_lamp(mi, tmp_path_factory):
    """A faceted bulb in a shade of few facets over a plate: every camera path may find it."""
    angle = np.linspace(-np.pi / 2, np.pi / 2, 7)
    ball = 0.3 * np.column_stack([np.cos(angle), np.sin(angle)])
    ball[[0, -1], 0] = 0.0
    emits = Material("bulb", Diffuse(reflectance=(0.4, 0.4, 0.4)), radiance=(3.0, 2.0, 1.0))
    shade = Material("shade", Diffuse(reflectance=(0.8, 0.6, 0.5)), two_sided=True)
    model = Geometry(
        (
            Part("bulb", lathe(ball, 10, crease=90), "bulb", (np.eye(4),)),
            Part("shade", lathe([[0.9, -0.3], [0.7, 0.2], [0.3, 0.6]], 12, crease=90), "shade"),
            Part("plate", lathe([[0, -0.9], [0.6, -0.9], [0.6, -0.8], [0, -0.8]], 24), "plate"),
        ),
        (emits, shade, Material("plate", metal((0.9, 0.8, 0.7), 0.6))),
    )
    return load_luminaire(write_scene(model, tmp_path_factory.mktemp("open")))


def camera_irradiance(mi, luminaire, rectangle):
    """[2, P²] irradiance by camera paths, and its standard error."""
    import drjit as dr

    from lumitree.rendering.register import register

    register()
    frame, count = luminaire.frame, rectangle.patches**2
    rng = np.random.default_rng(1)
    local = rectangle.points(frame.half_extents, rng.random((count, POINTS, 2))).reshape(-1, 3)
    points = local @ frame.world_from_local[:3, :3].T + frame.centre
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": 128})
    found = []
    for number, sign in enumerate(NORMALS):
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(number, len(points))
        normal = np.zeros(3)
        normal[rectangle.axis] = sign
        around = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
        ray = mi.RayDifferential3f(
            mi.Ray3f(on_device(mi.Point3f, points), mi.Frame3f(normal.tolist()).to_world(around))
        )
        radiance, *_ = integrator.sample(luminaire.scene, sampler, ray)
        values = np.pi * np.array(mi.luminance(mi.Color3f(radiance))).reshape(count, POINTS)
        found.append((values.mean(axis=1), values.std(axis=1, ddof=1) / np.sqrt(POINTS)))
        dr.sync_thread()
    return (np.array(each) for each in zip(*found, strict=True))


@pytest.mark.slow
def test_light_paths_and_camera_paths_agree(mi, open_lamp):
    from benchmarks.inside_box.crossings import BATCHES, crossing_irradiance

    scores = []
    reference = crossing_irradiance(open_lamp, RECTANGLES, PATHS)
    for rectangle, batches in zip(RECTANGLES, reference, strict=True):
        batches = batches.reshape(BATCHES, 2, -1)
        values, errors = camera_irradiance(mi, open_lamp, rectangle)
        assert (values.max(axis=1) > 0).any()
        error = np.hypot(batches.std(axis=0, ddof=1) / np.sqrt(BATCHES), errors)
        # No light reaches the lower side of the plane below the lamp.
        lit = error > 0
        assert (values[~lit] == batches.mean(axis=0)[~lit]).all()
        scores.append(((batches.mean(axis=0) - values)[lit]) / error[lit])
    scores = np.concatenate(scores)
    assert len(scores) > 100
    assert abs(scores.mean()) < 4 / np.sqrt(len(scores))
    assert scores.std() < 1.3
    assert np.abs(scores).max() < 5


@pytest.mark.parametrize(("bias", "bake_noise"), [(0.0, 0.2), (0.1, 0.0), (0.1, 0.2)])
def test_errors_are_without_noise(bias, bake_noise):
    rng = np.random.default_rng(0)
    truth = rng.uniform(0.5, 1.5, (30, 30))
    pattern = np.where(rng.random(truth.shape) < 0.5, 1 + bias, 1 - bias)

    def noisy(values, noise, shape):
        return values * (1 + noise * rng.normal(size=(*shape, *truth.shape)))

    bakes = noisy(pattern * truth, bake_noise, (2, 1))
    baked = noisy(bakes, 0.1, (2, 2))
    found = patch_errors(baked, noisy(truth, 0.3, (16,)), np.ones(truth.shape, bool))
    assert found is not None
    assert found.patches == 900
    assert found.ratio == pytest.approx(1, abs=0.03)
    assert found.ratio_error == pytest.approx(0.3 / np.sqrt(16 * 900), abs=0.006)
    # The mean of 900 squared differences keeps some of their noise.
    assert found.rms**2 == pytest.approx(bias**2, abs=0.005)
    assert found.rms_error < 0.05
    assert found.rms_of_one == pytest.approx(np.hypot(bias, bake_noise), abs=0.02)
    planes = over_planes([found, found])
    assert planes is not None
    assert planes["rms"] == pytest.approx(found.rms)
