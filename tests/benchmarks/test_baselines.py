"""Representations of a luminaire's light, fitted to rays whose irradiance is known."""

import numpy as np
import pytest

from benchmarks.baselines.traced_rays import TracedRays
from support.slow import slow_but_sets

HALF = np.array([1.0, 0.75, 0.5])
PATHS = 1 << 18


def far_field(rays):
    from benchmarks.baselines.fitting import far_field_point

    return far_field_point(rays)


def sphere(rays):
    from benchmarks.baselines.fitting import far_field_sphere

    return far_field_sphere(rays)


def points(rays):
    from benchmarks.baselines.fitting import point_lights

    return point_lights(rays, 8, 16, seed=3)


def table(rays):
    from benchmarks.baselines.fitting import box_table

    return box_table(rays, 8, 16)


def harmonics(rays):
    from benchmarks.baselines.fitting import box_harmonics

    return box_harmonics(rays, 8, 4)


def wavelets(rays):
    pytest.importorskip("pywt", reason="PyWavelets is not installed; the extra `dev` has it")
    from benchmarks.baselines.fitting import wavelet_light

    return wavelet_light(rays, 8, 16, 100_000)


def light_field(rays):
    from benchmarks.baselines.fitting import light_field

    return light_field(rays, 3, 16)


def ray_set(rays):
    from benchmarks.baselines.fitting import RaySet

    return RaySet(rays, 1 << 16, seed=4)


@pytest.fixture(scope="module")
def rays():
    """Light of two small balls, red to the left and green to the right, cosine-like upwards."""
    random = np.random.default_rng(5)
    direction = random.normal(size=(PATHS, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    right = random.random(PATHS) < 0.5
    origin = 0.1 * random.uniform(-1, 1, (PATHS, 3))
    origin[:, 0] += np.where(right, 0.5, -0.5)
    flux = (1 + direction[:, 1])[:, None] * np.where(right[:, None], [0, 2.0, 0], [1.0, 0, 0])
    return TracedRays(
        origin.astype(np.float32),
        direction.astype(np.float32),
        flux.astype(np.float32) / PATHS,
        HALF,
    )


def seeded(mi, count, seed=0):
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, count)
    return sampler


def test_patches_are_where_light_leaves_the_box(mi):
    import drjit as dr

    from benchmarks.baselines.places import Patches

    patches = Patches(HALF, 8)
    assert patches.count == 2 * (8 * 6 + 6 * 4 + 8 * 4)
    index = dr.arange(mi.UInt32, patches.count)
    sampler = seeded(mi, patches.count)
    point = patches.point(index, None, sampler.next_1d(), sampler.next_2d())
    place = np.array(point).T
    assert (np.abs(place) <= HALF * (1 + 1e-6)).all()
    # Lines through points of the patches, from inside and from both sides of the box.
    inside = mi.Vector3f(point) * sampler.next_1d()
    direction = dr.normalize(mi.Vector3f(point) - inside)
    for origin in (inside, mi.Vector3f(point) + 3 * direction, mi.Vector3f(point) - 9 * direction):
        found, area, hit = patches.seen(mi.Point3f(origin), direction)
        assert dr.all(hit)
        assert np.mean(np.array(found) == np.array(index)) > 0.97
    axis = np.abs(np.abs(place) / HALF - 1).argmin(axis=1)
    cosine = np.abs(np.array(direction).T[np.arange(len(axis)), axis])
    faces = np.array([HALF[1] * HALF[2] / 24, HALF[2] * HALF[0] / 32, HALF[0] * HALF[1] / 48])
    np.testing.assert_allclose(np.array(area), 4 * faces[axis] * cosine, rtol=1e-3)
    assert not dr.any(patches.seen(mi.Point3f(0, 2, 0), mi.Vector3f(1, 0, 0))[2])


@pytest.mark.parametrize(
    "fit", [far_field, sphere, points, table, harmonics, wavelets, light_field, ray_set]
)
def test_flux_is_that_of_the_rays(mi, rays, fit):
    flux = fit(rays).draw(PATHS, 0).flux
    expected = rays.flux.sum(axis=0, dtype=np.float64)
    flux = np.array(flux, np.float64)
    error = flux.std(axis=1) * np.sqrt(PATHS)
    # Histograms and harmonics have the rays' flux; the stored numbers of the light field
    # are rounded, and a ray set is a sample.
    slack = 6 / np.sqrt(1 << 16) if fit is ray_set else 0.002
    assert (np.abs(flux.sum(axis=1) - expected) <= 5 * error + slack * expected.max()).all()


FAR, NEAR = (0.4, 4, 0.3), (1.5, 0.9, -0.8)


# What is quick here and in the test below has each fit at least once.
@pytest.mark.parametrize(
    ("fit", "place"),
    slow_but_sets(
        [(far_field, FAR), (points, NEAR), (harmonics, NEAR), (wavelets, FAR), (light_field, NEAR)],
        [far_field, sphere, points, table, harmonics, wavelets, light_field],
        [FAR, NEAR],
    ),
)
def test_directions_bring_what_rays_do(mi, rays, fit, place):
    """Irradiance on a small disk, by directions towards the lamp and by rays that hit it."""
    import drjit as dr

    made = fit(rays)
    count, radius = 1 << 22, 0.2
    centre = np.array(place)
    normal = -centre / np.linalg.norm(centre)
    drawn = made.draw(count, 1)
    origin, direction, flux = drawn.origin, drawn.direction, drawn.flux
    n, c = mi.Vector3f(normal.tolist()), mi.Point3f(centre.tolist())
    cosine = -dr.dot(direction, n)
    t = dr.dot(c - origin, n) / dr.dot(direction, n)
    hits = (cosine > 0) & (t > 0) & (dr.norm(origin + t * direction - c) < radius)
    traced = np.array(dr.select(hits, flux, 0), np.float64) / (np.pi * radius**2)
    # Receivers spread over the disk.
    sampler = seeded(mi, 1 << 18, 2)
    offset = radius * mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
    x = c + mi.Frame3f(n).to_world(mi.Vector3f(offset.x, offset.y, 0))
    towards, value = made.sample_direction(x, sampler)
    received = np.array(value * dr.maximum(dr.dot(towards, n), 0), np.float64)
    found, expected = received.mean(axis=1), traced.sum(axis=1)
    error = np.hypot(
        received.std(axis=1) / np.sqrt(received.shape[1]), traced.std(axis=1) * np.sqrt(count)
    )
    assert expected.max() > 0
    assert (np.abs(found - expected) < 4.5 * error + 1e-9).all()


@pytest.mark.parametrize(
    ("fit", "place"),
    slow_but_sets(
        [(sphere, NEAR), (table, FAR), (harmonics, FAR), (light_field, NEAR)],
        [sphere, table, harmonics, wavelets, light_field],
        [FAR, NEAR],
    ),
)
def test_lines_show_what_directions_bring(mi, rays, fit, place):
    """Irradiance by directions of their own, and by uniform ones towards the box's corners."""
    import drjit as dr

    from lumitree.rendering.sampling.proxy import cone_pdf, sample_cone

    made, count, radius = fit(rays), 1 << 20, float(np.linalg.norm(HALF))
    x, normal = mi.Point3f(place), -dr.normalize(mi.Vector3f(place))
    direction, value = made.sample_direction(x, seeded(mi, count, 6))
    received = np.array(value * dr.maximum(dr.dot(direction, normal), 0), np.float64)
    uniform = sample_cone(x, radius, seeded(mi, count, 7).next_2d())
    seen = made.eval(x, -uniform) * dr.maximum(dr.dot(uniform, normal), 0)
    seen = np.array(seen / cone_pdf(x, radius), np.float64)
    error = np.hypot(received.std(axis=1), seen.std(axis=1)) / np.sqrt(count)
    assert seen.max() > 0
    assert (np.abs(received.mean(axis=1) - seen.mean(axis=1)) < 4.5 * error + 1e-9).all()


@pytest.mark.parametrize("fit", [far_field, points, ray_set])
def test_lines_see_no_points(mi, rays, fit):
    assert fit(rays).eval(mi.Point3f(0, -3, 0), mi.Vector3f(0, -1, 0)) is None


def test_a_ray_set_answers_no_receiver(mi, rays):
    assert ray_set(rays).sample_direction(mi.Point3f(0, -3, 0), seeded(mi, 1)) is None


@pytest.mark.slow
def test_the_benchmark_makes_a_row_for_each(tmp_path, monkeypatch, capsys):
    import json

    from benchmarks import representations
    from benchmarks.__main__ import main

    monkeypatch.setattr(representations, "SAMPLES", 1 << 10)
    monkeypatch.setattr(representations, "QUERIES", 1 << 10)
    chosen = {
        "light field 32³ x 32²": light_field,
        "far field, point": far_field,
        "ray set": ray_set,
    }
    words = ("point lights", "box table", "harmonics")
    chosen |= {
        f"{word} 8": fit for word, fit in zip(words, (points, table, harmonics), strict=True)
    }
    monkeypatch.setattr(representations, "fits", lambda *_: chosen)
    options = ["--paths", "1000", "--reference", "20000", "--views", "1", "--resolution", "16"]
    options += ["--spp", "4", "-o", str(tmp_path)]
    assert main(["representations", "dallas", *options]) == 0
    rows = json.loads((tmp_path / "representations.json").read_text())["rows"]
    assert [row["representation"] for row in rows] == list(chosen)
    assert all(row["bytes"] > 0 and row["seconds"] > 0 for row in rows)
    assert {row["representation"] for row in rows if "variance" not in row} == {"ray set"}
    invisible = {"ray set", "far field, point", "point lights 8"}
    assert {row["representation"] for row in rows if "images" not in row} == invisible
    printed = capsys.readouterr().out
    assert all(name in printed for name in chosen)
    assert (tmp_path / "representations.png").stat().st_size > 1000
