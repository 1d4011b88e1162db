"""Irradiance around a luminaire: closed forms, quadrature, baked lamps, and warnings of errors."""

import warnings

import numpy as np
import pytest

from lumitree.asset.asset import light_field_asset
from lumitree.core.photometry import luminance
from lumitree.core.results import Stopwatch
from lumitree.errors import LumitreeWarning
from lumitree.fit.light_field.bake import bake_light_field
from lumitree.measure.batches import BATCHES
from lumitree.measure.irradiance import (
    CUBE_HALF_SIDE,
    FACES,
    PATCHES,
    Irradiance,
    asset_irradiance,
    evaluate_irradiance,
    irradiance_error,
    luminaire_irradiance,
    measure_irradiance,
)
from lumitree.octree.field import Field
from lumitree.trace.light_field_config import LightFieldConfig
from support.fields import random_asset, uniform_asset
from support.lamps import AREA, cube, lamp_of, sphere

SIDE = 2 * CUBE_HALF_SIDE / PATCHES


def patch_points(face, count, half_extents=(1, 1, 1)):
    """Points [P, P, count², 3] of the patches of a face, evenly spread, and its normal [3]."""
    axis, sign = (1, 1) if face == 6 else (face // 2, 1 - 2 * (face % 2))
    height = -half_extents[1] if face == 6 else -sign * CUBE_HALF_SIDE
    steps = (np.arange(PATCHES * count) + 0.5) * SIDE / count - CUBE_HALF_SIDE
    grid = np.stack(np.meshgrid(steps, steps, indexing="ij"), axis=-1)
    grid = grid.reshape(PATCHES, count, PATCHES, count, 2).swapaxes(1, 2)
    points = np.insert(grid.reshape(PATCHES, PATCHES, count**2, 2), axis, height, axis=-1)
    return points, sign * np.eye(3)[axis]


def z_scores(estimate, expected):
    """z-scores of patches and channels; a dark one must be expected to be dark."""
    error = estimate.batches.std(axis=0, ddof=1) / np.sqrt(len(estimate.batches))
    assert (estimate.mean[error == 0] == 0).all()
    return (estimate.mean - expected)[error > 0] / error[error > 0]


def test_a_sphere_lights_its_surroundings_by_the_closed_form(mi, tmp_path):
    """E = π L R² cos θ / d² wherever the whole sphere is above the horizon."""
    estimate = luminaire_irradiance(lamp_of(tmp_path, sphere("ball", 2, (5, -3, 1), AREA)), 1 << 20)
    expected = np.zeros_like(estimate.mean)
    for face in range(len(FACES)):
        points, normal = patch_points(face, 16)
        cube = np.linalg.norm(points, axis=-1) ** 3
        form = (np.pi * -(points @ normal) / cube).mean(axis=-1)
        expected[face] = form[..., None] * [3, 2, 1]
    z = z_scores(estimate, expected)
    # Student's t of 15 degrees of freedom, a thousand patches of three channels that depend.
    assert np.abs(z).max() < 9
    assert np.square(z).mean() == pytest.approx(15 / 13, rel=0.25)
    # Sharper than any patch: the faces, and what leaves in all.
    assert estimate.mean.mean((1, 2)) == pytest.approx(expected.mean((1, 2)), rel=0.01)
    flux = estimate.mean[:6].sum((0, 1, 2)) * SIDE**2
    assert flux == pytest.approx(4 * np.pi**2 * np.array([3, 2, 1]), rel=1e-5)


@pytest.mark.slow
@pytest.mark.parametrize("face", [3, 4, 6])
def test_a_field_lights_its_surroundings_as_lines_towards_it_say(mi, face):
    """Against the mean over points of a patch and directions to the bounding sphere."""
    half_extents = np.array([1.0, 0.7, 0.8])
    asset = random_asset(4, law="exponential", half_extents=half_extents)
    field = Field(asset)
    estimate = asset_irradiance(asset, 1 << 20)
    random = np.random.default_rng(face)
    points, normal = patch_points(face, 1, half_extents)
    count, batches = 1 << 17, 16
    radius = np.linalg.norm(half_extents)
    for place in [(2, 9), (6, 6), (7, 3)]:
        centre = points[place][0]
        across = np.where(normal == 0, random.uniform(-SIDE / 2, SIDE / 2, (count * batches, 3)), 0)
        origin = centre + across
        towards = random.normal(size=origin.shape)
        towards *= radius / np.linalg.norm(towards, axis=1, keepdims=True)
        # Uniform in direction as seen from the point: by area of the bounding sphere.
        offset = towards - origin
        distance = np.linalg.norm(offset, axis=1, keepdims=True)
        direction = offset / distance
        facing = -(direction * towards).sum(1, keepdims=True) / radius
        # From outside each line crosses the sphere twice; its near side stands for it.
        inside = np.linalg.norm(origin, axis=1, keepdims=True) < radius
        facing = np.where(inside, -facing, np.maximum(facing, 0))
        cosine = direction @ normal
        radiance, _ = field.eval_rays(origin.astype(np.float32), direction.astype(np.float32))
        weight = facing / distance**2 * 4 * np.pi * radius**2
        weight *= np.maximum(cosine, 0)[:, None]
        values = (radiance * weight).reshape(batches, count, 3).mean(1)
        expected, error = values.mean(0), values.std(0, ddof=1) / np.sqrt(batches)
        found = estimate.batches[(slice(None), face, *place)]
        noise = found.std(0, ddof=1) / np.sqrt(len(found))
        assert (np.hypot(error, noise) < 0.05 * expected).all()
        assert (np.abs(found.mean(0) - expected) < 5 * np.hypot(error, noise)).all()


def test_errors_are_found_and_noise_is_not_taken_for_one(mi):
    random = np.random.default_rng(0)
    truth = random.uniform(1, 2, (len(FACES), PATCHES, PATCHES, 3))

    def noisy(values, noise):
        return Irradiance(values * (1 + noise * random.normal(size=(16, *values.shape))))

    same = irradiance_error(noisy(truth, 0.2), noisy(truth, 0.1))
    assert (np.abs(same.ratio - 1) < 5 * same.ratio_error).all()
    assert (same.rms < 0.05).all()
    # A difference that noise hides has an error all the same.
    assert ((same.rms_error > 0.002) & (same.rms_error < 0.1)).all()
    assert (same.rms < 5 * same.rms_error).all()
    pattern = truth * (1.03 + 0.1 * np.sign(random.normal(size=(*truth.shape[:3], 1))))
    other = irradiance_error(noisy(pattern, 0.2), noisy(truth, 0.1))
    square = truth.sum(-1) ** 2
    expected = np.sqrt((((pattern - truth).sum(-1)) ** 2).sum((1, 2)) / square.sum((1, 2)))
    assert other.ratio == pytest.approx(1.03, abs=0.03)
    assert other.rms == pytest.approx(expected, abs=0.03)
    assert (np.abs(other.rms - expected) < 5 * other.rms_error + 0.01).all()
    assert (other.rms_error < 0.02).all()
    assert other.mean_rms == pytest.approx(other.rms[:6].mean())
    total = pattern[:6].sum((0, 1, 2)) / truth[:6].sum((0, 1, 2))
    assert abs(other.total_ratio - total.mean()) < 5 * other.total_ratio_error + 0.001
    # Sharper than any face.
    assert other.total_ratio_error < other.ratio_error[:6].min()


def test_faces_that_receive_no_light_are_not_compared(mi):
    random = np.random.default_rng(0)
    lit = random.uniform(1, 2, (16, len(FACES), PATCHES, PATCHES, 3))
    lit[:, 3] = 0
    # Reached by a single path: its light is known to be there, but not where it goes.
    rare = lit.copy()
    rare[:, 2], rare[0, 2, 4, 5] = 0, 1
    error = irradiance_error(Irradiance(1.1 * rare), Irradiance(rare))
    assert np.isnan(error.ratio).tolist() == [face == 3 for face in range(7)]
    assert np.isnan(error.rms).tolist() == [face in (2, 3) for face in range(7)]
    assert error.ratio[[0, 1, 2, 4, 5, 6]] == pytest.approx(1.1)
    assert error.mean_rms == pytest.approx(error.rms[[0, 1, 4, 5]].mean())
    assert error.total_ratio == pytest.approx(1.1)
    dark = irradiance_error(Irradiance(lit), Irradiance(0 * lit))
    assert np.isnan([*dark.ratio, *dark.rms, dark.total_ratio, dark.mean_rms]).all()


def test_a_field_equal_to_its_luminaire_has_no_error(mi, tmp_path):
    """A cube of uniform radiance, and an opaque field that emits as it does."""
    lamp = lamp_of(tmp_path, cube("cube", 2, (1, 2, 3), AREA))
    found = evaluate_irradiance(uniform_asset(1e4, [3.0, 2.0, 1.0]), lamp, 1 << 18)
    metrics = found.metrics
    assert list(metrics) == ["irradiance_ratio", "irradiance_rms", "irradiance_rms_touching"]
    assert metrics["irradiance_ratio"] == pytest.approx(1, abs=0.005)
    assert metrics["irradiance_rms"] < 0.03
    assert metrics["irradiance_rms_touching"] < 0.03
    report = found.report()
    assert report["paths"] == 1 << 18
    assert list(report["faces"]) == list(FACES)
    # All light of the cube reaches its six surroundings: π L times its surface, over theirs.
    expected = np.pi * luminance([3, 2, 1]) / CUBE_HALF_SIDE**2
    walls = [report["faces"][face] for face in FACES[:6]]
    assert [each["explicit_lux"] for each in walls] == pytest.approx([expected] * 6, rel=0.02)
    assert [each["baked_lux"] for each in walls] == pytest.approx([expected] * 6, rel=0.02)
    for each in walls:
        assert each["ratio"] == pytest.approx(each["baked_lux"] / each["explicit_lux"])
        assert abs(each["ratio"] - 1) < 6 * each["ratio_error"] < 0.06
    brighter = evaluate_irradiance(uniform_asset(1e4, [3.6, 2.4, 1.2]), lamp, 1 << 18).metrics
    assert brighter["irradiance_ratio"] == pytest.approx(1.2, abs=0.006)
    assert brighter["irradiance_rms"] == pytest.approx(0.2, abs=0.02)
    assert brighter["irradiance_rms_touching"] == pytest.approx(0.2, abs=0.02)


def test_it_is_the_same_for_the_same_seed(mi, tmp_path):
    lamp = lamp_of(tmp_path, sphere("ball", 2, inside=AREA))
    first, second, third = (luminaire_irradiance(lamp, 1 << 12, seed=s).batches for s in (1, 1, 2))
    assert (first == second).all()
    assert (first != third).any()
    assert len(first) == BATCHES


PATHS = 1 << 16
DISK = f'<shape type="disk" id="disk">{AREA}</shape>'


def _measured(folder, depth, resolution, *shapes):
    """`irradiance` of a lamp, whose light field has bins of this number a side."""
    lamp = lamp_of(folder, *shapes)
    config = LightFieldConfig(paths=PATHS, batch=PATHS, depth=depth, resolution=resolution)
    field = bake_light_field(lamp, config, folder)
    return measure_irradiance(
        light_field_asset(field, lamp.frame, "lamp"), lamp, PATHS, Stopwatch()
    )


@pytest.mark.parametrize(
    ("depth", "others", "cause"),
    [
        (5, (), "narrow beams"),
        (1, (), "only 4 cells"),
        (3, (cube("pole", (0.1, 0.1, 4), (0, 0, -4.2)),), "in one far part of its box"),
    ],
)
def test_a_large_error_is_told_with_its_likely_cause(mi, tmp_path, depth, others, cause):
    """A disk, which emits to one side, in bins of 45 degrees."""
    with pytest.warns(
        LumitreeWarning, match=rf"RMS error of \d\d%, expected at most 10%: .*{cause}"
    ):
        found = _measured(tmp_path, depth, 4, DISK, *others)
    assert found["irradiance_rms"] > 0.1


def test_a_small_error_is_not(mi, tmp_path):
    with warnings.catch_warnings():
        warnings.simplefilter("error", LumitreeWarning)
        found = _measured(tmp_path, 4, 32, DISK)
    assert found["irradiance_rms"] < 0.05
