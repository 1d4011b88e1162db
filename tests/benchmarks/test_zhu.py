"""The networks of Zhu et al. 2021: directions by cells of a cone, and a training."""

import dataclasses
import json

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from scipy import stats

from benchmarks.__main__ import main
from benchmarks.baselines import descent
from benchmarks.baselines.descent import Budget
from benchmarks.baselines.direction_cells import (
    cone_directions,
    density_of_cells,
    sample_cells,
    solid_angle,
)
from benchmarks.baselines.zhu import train_zhu
from benchmarks.baselines.zhu_networks import RayNetworks, ZhuConfig, sphere_entry
from lumitree.core.directions import orthographic_rays, view_pose
from lumitree.fit.network.ray_set import RaySet

RADIUS, RINGS, SECTORS = 1.3, 5, 8
COUNT, BINS = 100_000, 12
# Also where the frame about the axis changes its sign, and just outside the sphere.
PLACES = [(0, -6, 0), (0.1, 0, 3), (0, 0, -2), (1.31, 0.2, -0.1)]


density_at = jax.jit(density_of_cells, static_argnums=(3, 4))


def _receivers(place, count):
    return jnp.asarray(np.repeat(np.array([place], np.float32), count, axis=0))


def _logits(count):
    cells = np.random.default_rng(1).normal(0, 1.5, RINGS * SECTORS)
    return jnp.broadcast_to(jnp.asarray(cells), (count, RINGS * SECTORS))


def _plane(place):
    """Axis of the cone [3], two vectors across it [2, 3], and the sine of its half angle."""
    axis = -np.array(place) / np.linalg.norm(place)
    across = np.linalg.svd(axis[None])[2][1:]
    return axis, across, RADIUS / np.linalg.norm(place)


def _expected(place):
    """Integrals [BINS, BINS] of the density over squares of the cone's projection on a plane."""
    axis, across, sine = _plane(place)
    fine = BINS * 60
    steps = ((np.arange(fine) + 0.5) / fine * 2 - 1) * sine
    a, b = (each.ravel() for each in np.meshgrid(steps, steps, indexing="ij"))
    cosine = np.sqrt(np.maximum(1 - a**2 - b**2, 0))
    directions = np.stack([a, b], axis=1) @ across + cosine[:, None] * axis
    receivers = _receivers(place, len(directions))
    density = density_at(_logits(1), receivers, jnp.asarray(directions), RADIUS, RINGS)
    inside = a**2 + b**2 < sine**2
    part = np.where(inside, np.asarray(density, float) / np.maximum(cosine, 1e-9), 0)
    part *= (2 * sine / fine) ** 2
    return part.reshape(BINS, 60, BINS, 60).sum(axis=(1, 3))


def _counts(place, directions):
    _, across, sine = _plane(place)
    square = np.clip((directions @ across.T / sine + 1) / 2 * BINS, 0, BINS - 1).astype(int)
    return np.bincount(square[:, 0] * BINS + square[:, 1], minlength=BINS**2).reshape(BINS, BINS)


@pytest.mark.parametrize("place", PLACES)
def test_densities_of_directions_integrate_to_one(place):
    assert _expected(place).sum() == pytest.approx(1, abs=0.005)
    past = np.array(place) / np.linalg.norm(place)
    assert density_at(_logits(1), _receivers(place, 1), past[None], RADIUS, RINGS) == 0


@pytest.mark.parametrize("place", PLACES[::3])
def test_directions_are_distributed_by_their_density(place):
    receivers = _receivers(place, COUNT)
    sample = jax.jit(sample_cells, static_argnums=(2, 3))
    directions, density = sample(_logits(COUNT), receivers, RADIUS, RINGS, jax.random.key(3))
    again = density_at(_logits(COUNT), receivers, directions, RADIUS, RINGS)
    # Rounding moves some samples into the next cell.
    assert (np.abs(density / again - 1) < 1e-3).mean() > 0.999
    expected = COUNT * _expected(place)
    found = _counts(place, np.asarray(directions, float))
    kept = expected > 10
    assert kept.sum() > BINS**2 / 2
    statistic = ((found - expected)[kept] ** 2 / expected[kept]).sum()
    assert stats.chi2.sf(statistic, kept.sum() - 1) > 1e-4


def test_uniform_places_fill_the_cone():
    receivers = _receivers((0.5, 2, 1), COUNT)
    places = np.random.default_rng(4).random((2, COUNT), np.float32)
    cone = jax.jit(cone_directions, static_argnums=1)
    directions = np.asarray(cone(receivers, RADIUS, *places), float)
    assert np.linalg.norm(directions, axis=1) == pytest.approx(1, abs=1e-5)
    place = np.array([0.5, 2, 1])
    assert (directions @ place).max() < 0
    assert np.linalg.norm(np.cross(place, directions), axis=1).max() < RADIUS * 1.0001
    # The mean cosine of a cone's directions is (1 + cosine of its half angle) / 2.
    axis = -np.array([0.5, 2, 1]) / np.sqrt(5.25)
    half = 1 - float(solid_angle(receivers[:1], RADIUS)[0]) / (2 * np.pi)
    assert (directions @ axis).mean() == pytest.approx((1 + half) / 2, abs=1e-3)
    assert half == pytest.approx(np.sqrt(1 - RADIUS**2 / 5.25), abs=1e-5)


@pytest.mark.parametrize("encoding", ["log", "linear"])
def test_radiance_is_decoded(encoding):
    networks = RayNetworks(ZhuConfig(width=4, encoding=encoding), 1.0, (2.5, 1.7), 40.0, seed=0)
    radiance = jnp.asarray([0.0, 1e-3, 0.5, 40.0])
    again = networks.decode(networks.standardise(radiance))
    np.testing.assert_allclose(again, radiance, rtol=1e-4, atol=1e-6)
    assert np.asarray(networks.decode(jnp.asarray([-1e4, 1e4]))) == pytest.approx([0, 40])


def test_rays_enter_the_sphere_before_they_leave_it():
    random = np.random.default_rng(5)
    directions = random.normal(size=(100, 3))
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    origins = random.uniform(-0.5, 0.5, (100, 3)) - 3 * directions
    points = np.asarray(sphere_entry(jnp.asarray(origins), jnp.asarray(directions), 2.0))
    assert np.linalg.norm(points, axis=1) == pytest.approx(2, abs=1e-5)
    assert ((points * directions).sum(axis=1) < 0).all()
    assert np.linalg.norm(np.cross(points - origins, directions), axis=1).max() < 1e-5


@pytest.mark.slow
def test_training_learns_a_ball():
    rays = _ball()
    config = dataclasses.replace(ZhuConfig(), width=32, blocks=1, rings=4, sectors=8)
    config = dataclasses.replace(
        config, position_frequencies=2, direction_frequencies=1, learning_rate_start=1e-2
    )
    trained = train_zhu(rays, np.array([1.0, 0.8, 0.7]), config, Budget(steps=200))
    assert trained.steps == 200
    batch = rays.held_out()
    radiance, opacity = trained.eval(np.asarray(batch.origins), np.asarray(batch.directions))
    assert radiance.min() >= 0
    assert 0 <= opacity.min() <= opacity.max() <= 1
    assert np.abs(opacity - batch.opacity).mean() < 0.5 * np.abs(batch.opacity).mean()
    error = ((radiance - batch.radiance) ** 2).mean()
    assert error < 0.5 * (np.asarray(batch.radiance) ** 2).mean()
    missed, opaque = trained.eval(np.array([[0, 5.0, 0]]), np.array([[1.0, 0, 0]]))
    assert not missed.any()
    assert not opaque.any()
    place = np.repeat([[0, 4.0, 0]], 2000, axis=0)
    directions, density = trained.sample(place, seed=1)
    np.testing.assert_allclose(np.median(trained.pdf(place, directions) / density), 1, rtol=1e-3)
    # Its network sees where the ball is: more directions hit it than of the whole cone's.
    nearest = np.linalg.norm(np.cross(place, directions), axis=1)
    assert (nearest < 0.5).mean() > 1.2 * (0.5 / np.sqrt(1 + 0.8**2 + 0.7**2)) ** 2


@pytest.mark.slow
def test_the_benchmark_makes_a_row_for_each(tmp_path, monkeypatch, capsys):
    monkeypatch.setattr(descent, "_WINDOW", 50)
    monkeypatch.setattr(descent, "_STEPS", 40)
    options = ["--views", "4", "--resolution", "24", "--spp", "8", "--test-views", "2"]
    options += ["--test-spp", "16", "--seconds", "2", "--converge", "-o", str(tmp_path)]
    assert main(["zhu", "dallas", *options]) == 0
    report = json.loads((tmp_path / "zhu.json").read_text())
    rows = {row["method"]: row for row in report["rows"]}
    assert list(rows) == [
        "Zhu et al.",
        "Zhu et al., converged",
        "network, octree",
        "direct, views",
        "direct",
    ]
    for row in rows.values():
        assert row["milliseconds"] > 0
        assert row["bytes"] > 1000
        assert np.isfinite(list(row["metrics"].values())).all()
    assert rows["Zhu et al., converged"]["steps"] >= 2 * (20 + 50)
    assert set(rows["Zhu et al."]["variance"]) == {"below", "beside", "near"}
    printed = capsys.readouterr().out
    assert all(name in printed for name in rows)
    assert (tmp_path / "zhu-dallas.png").stat().st_size > 1000


def _ball(views=6, side=48, half_width=1.4):
    """Rays through a box that holds a ball of radius 0.5 and radiance 3."""
    poses = [view_pose(index, 2.0) for index in range(1, views + 1)]
    rays = [orthographic_rays(pose, half_width, side) for pose in poses]
    hit = [np.linalg.norm(np.cross(o, d), axis=-1).ravel() < 0.5 for o, d in rays]
    opacity = np.concatenate(hit).astype(np.float32)
    return RaySet(
        corners=np.stack([o[0, 0] for o, _ in rays]),
        column_steps=np.stack([o[0, 1] - o[0, 0] for o, _ in rays]),
        row_steps=np.stack([o[1, 0] - o[0, 0] for o, _ in rays]),
        directions=np.stack([d for _, d in rays]),
        resolution=side,
        view=np.repeat(np.arange(views, dtype=np.uint16), side**2),
        pixel=np.tile(np.arange(side**2, dtype=np.uint32), views),
        radiance=3 * np.repeat(opacity[:, None], 3, axis=1),
        opacity=opacity,
        max_radiance=3.0,
    )
