"""The benchmark of light inside a lamp's box: its reference, its patches, its figures."""

import json

import numpy as np
import pytest

from benchmarks.__main__ import main
from benchmarks.inside_box.figures import masks, over_planes, patch_errors, shadow
from benchmarks.inside_box.patches import NORMALS, Rectangle, surroundings
from lumitree.core.device import on_device
from lumitree.fit.config import QUALITIES
from lumitree.lamp.loading import load_luminaire
from lumitree.lamp.meshes import lathe
from lumitree.lamp.parts import Diffuse, Geometry, Material, Metal, Part
from lumitree.lamp.scene_writer import write_scene
from lumitree.trace.light_field_config import LightFieldConfig
from support import tiny_bakes
from support.lamps import AREA, scene, sphere

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
    emits = Material("bulb", Diffuse((0.4, 0.4, 0.4)), radiance=(3.0, 2.0, 1.0))
    shade = Material("shade", Diffuse((0.8, 0.6, 0.5)), two_sided=True)
    model = Geometry(
        (
            Part("bulb", lathe(ball, 10, crease=90), "bulb", (np.eye(4),)),
            Part("shade", lathe([[0.9, -0.3], [0.7, 0.2], [0.3, 0.6]], 12, crease=90), "shade"),
            Part("plate", lathe([[0, -0.9], [0.6, -0.9], [0.6, -0.8], [0, -0.8]], 24), "plate"),
        ),
        (emits, shade, Material("plate", Metal((0.9, 0.8, 0.7), 0.6, "none"))),
    )
    return load_luminaire(write_scene(model, tmp_path_factory.mktemp("open")))


def camera_irradiance(mi, luminaire, rectangle):
    """[2, P²] irradiance by camera paths, and its standard error."""
    import drjit as dr

    from lumitree.rendering.plugins.register import register

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


def test_patches_cover_their_part_of_a_plane():
    half, rectangle = np.array([0.5, 1.0, 0.25]), Rectangle(1, 0.25, 4, part=0.8)
    points = rectangle.points(half, np.random.default_rng(0).random((16, 500, 2)))
    assert rectangle.name == "y 25 %"
    assert (points[..., 1] == -0.5).all()
    np.testing.assert_allclose(np.abs(points).max(axis=(0, 1)), [0.4, 0.5, 0.2], rtol=0.01)
    # Rows along x, columns along z.
    np.testing.assert_allclose(points[4:8, :, 0].mean(), -0.1, atol=0.01)
    np.testing.assert_allclose(points[3::4, :, 2].mean(), 0.15, atol=0.01)
    np.testing.assert_allclose(rectangle.steps(half), [0.2, 0.1])


def test_surroundings_of_a_lamp(mi, open_lamp):
    distance, leaving = surroundings(open_lamp, Rectangle(1, -0.02, 8))
    # The lamp is 1.5 high and 1.8 wide, and the plate is its lowest part.
    assert distance[3:5, 3:5] == pytest.approx(0.02 * 1.5 / 0.9, rel=0.05)
    assert distance[0, 0] > 0.3
    assert (leaving > 0.4).all()
    found = masks(np.array([0.2, 0.05, 0.2]), np.array([0.3, 0.3, 0.001]))
    assert [mask.tolist() for mask in found.values()] == [
        [True, False, False],
        [False, True, False],
        [True, True, False],
    ]


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
    assert found.patches == 900
    assert found.ratio == pytest.approx(1, abs=0.03)
    assert found.ratio_error == pytest.approx(0.3 / np.sqrt(16 * 900), abs=0.006)
    # What is left of the noise of 900 squared differences.
    assert found.rms**2 == pytest.approx(bias**2, abs=0.005)
    assert found.rms_error < 0.05
    assert found.rms_of_one == pytest.approx(np.hypot(bias, bake_noise), abs=0.02)
    assert over_planes([found, found])["rms"] == pytest.approx(found.rms)


def test_nothing_is_said_of_patches_without_light():
    baked, dark = np.ones((2, 2, 3, 3)), np.zeros((8, 3, 3))
    everywhere = np.ones((3, 3), bool)
    assert patch_errors(baked, dark, everywhere) is None
    assert patch_errors(baked, dark + 1, ~everywhere) is None
    dark[0] = 1  # one path in one batch
    assert patch_errors(baked, dark, everywhere) is None
    assert over_planes([]) is None


def test_light_in_the_shadow_under_a_lamp():
    reference = np.ones((10, 10))
    reference[4:6, 4:8] = 0.001
    baked = reference + 0.05
    found = shadow(baked, reference)
    assert found == pytest.approx(
        {"patches": 8, "reference": 0.001, "baked": 0.051, "baked_95": 0.051}
    )
    assert shadow(baked, np.ones((10, 10))) is None


@pytest.mark.slow
def test_a_lamp_from_end_to_end(mi, tmp_path, monkeypatch, capsys):
    """A sphere above a disc, from whose lower side no light comes."""
    from benchmarks.inside_box import baked

    tiny_bakes.set_qualities(monkeypatch.setitem)
    few = tiny_bakes.standard(light_field=LightFieldConfig(1 << 18, batch=1 << 18))
    monkeypatch.setitem(QUALITIES, "standard", few)
    monkeypatch.setattr(baked, "_RECEIVERS", 1 << 10)
    monkeypatch.setattr(baked, "_SAMPLES", 64)
    monkeypatch.chdir(tmp_path)
    disc = (
        '<shape type="disk" id="disc"><transform name="to_world"><rotate x="1" angle="-90"/>'
        '<scale value="0.15"/><translate y="-0.8"/></transform>'
        '<bsdf type="twosided"><bsdf type="diffuse"/></bsdf></shape>'
    )
    lamp = scene(sphere("bulb", 0.3, inside=AREA), disc)
    (tmp_path / "lamp.xml").write_text(lamp)
    assert main(["near_field", "lamp.xml", "--paths", str(1 << 20), "-o", "out"]) == 0
    report = json.loads((tmp_path / "out" / "near_field.json").read_text())
    (row,) = report["luminaires"]
    assert [plane["lit_from"] for plane in row["planes"]][:5] == ["+y", "+y", "+y", "-y", "+y"]
    for way in ("geometry", "light"):
        found = row[way]
        assert found["horizontal"]["far"]["ratio"] == pytest.approx(1, abs=0.06)
        assert found["horizontal"]["far"]["rms"] < 0.1
        assert found["noise"]["inside"]["product"] > 0
    # The disc's shadow has a sharp border only where the disc is in the scene.
    assert row["geometry"]["shadow"]["reference"] < 0.01
    assert row["geometry"]["shadow"]["baked"] < row["light"]["shadow"]["baked"]
    assert row["before"]["touching"]["rms"] > 0
    assert len(row["bake_seconds"]) == 2
    text = (tmp_path / "out" / "near_field.md").read_text()
    shown = capsys.readouterr().out
    for name in ("y 25 %", "time * variance / outside", "over before"):
        assert name in text
        assert name in shown
