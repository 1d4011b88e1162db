"""The normalizing flow over rays, and its splines."""

from types import SimpleNamespace

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from flax import nnx
from scipy import stats

from benchmarks.baselines.spline_flow import SplineFlow, spline_of, to_x, to_z
from benchmarks.baselines.traced_rays import TracedRays

HALF, COUNT = np.array([1.0, 0.75, 0.5]), 50_000


@pytest.fixture(scope="module")
def flow():
    """A flow that is not the identity."""
    graph, params = nnx.split(SplineFlow(2, 5, 8, seed=0))
    random = np.random.default_rng(1)
    moved = jax.tree.map(
        lambda x: jnp.asarray(x + 0.1 * random.normal(size=x.shape), jnp.float32), params
    )
    made = nnx.merge(graph, moved)
    return SimpleNamespace(
        sample=jax.jit(lambda z: made.sample(z)),
        log_density=jax.jit(lambda x: made.log_density(x)),
        jacobian=jax.jit(jax.vmap(jax.jacfwd(lambda v: made.sample(v[None])[0][0]))),
    )


def _even(count, seed):
    return jnp.asarray(np.random.default_rng(seed).random((count, 4), np.float32))


def test_splines_are_monotonic_and_invertible():
    raw = jnp.asarray(np.random.default_rng(0).normal(0, 2, 3 * 6 + 1), jnp.float32)
    z = jnp.linspace(0, 1, 1001)
    spline = jax.tree.map(lambda v: jnp.broadcast_to(v, (len(z), *v.shape)), spline_of(raw))
    x, log_slope = jax.jit(to_x)(spline, z)
    assert (jnp.diff(x) > 0).all()
    assert float(x[0]) == 0
    assert float(x[-1]) == pytest.approx(1, abs=1e-6)
    again, same = jax.jit(to_z)(spline, x)
    np.testing.assert_allclose(again, z, atol=2e-4)
    np.testing.assert_allclose(same, log_slope, atol=0.02)
    # The density is that of the map's slope.
    slopes = jax.jit(jax.grad(lambda t: to_x(spline, t)[0].sum()))(z)[1:-1]
    np.testing.assert_allclose(jnp.log(slopes), log_slope[1:-1], atol=1e-3)


def test_zeros_are_the_identity():
    z = jnp.linspace(0, 1, 11)
    spline = jax.tree.map(lambda v: jnp.broadcast_to(v, (11, *v.shape)), spline_of(jnp.zeros(13)))
    for found in (jax.jit(to_x)(spline, z), jax.jit(to_z)(spline, z)):
        np.testing.assert_allclose(found[0], z, atol=1e-6)
        np.testing.assert_allclose(found[1], 0, atol=1e-5)


@pytest.mark.slow
def test_density_of_the_flow_is_that_of_its_samples(flow):
    z = _even(COUNT, 2)
    x, log_density = flow.sample(z)
    assert 0 <= float(x.min()) <= float(x.max()) <= 1
    np.testing.assert_allclose(flow.log_density(x), log_density, atol=1e-3)
    wanted = -np.log(np.abs(np.linalg.det(np.asarray(flow.jacobian(z[:50]), np.float64))))
    np.testing.assert_allclose(log_density[:50], wanted, atol=1e-3)


def test_density_of_the_flow_integrates_to_one(flow):
    x = _even(COUNT, 3)
    density = np.exp(np.asarray(flow.log_density(x), np.float64))
    assert density.std() > 0.5
    error = density.std() / np.sqrt(len(density))
    assert density.mean() == pytest.approx(1, abs=4.5 * error)


def test_samples_of_the_flow_are_distributed_by_its_density(flow):
    bins = 12
    x, _ = flow.sample(_even(COUNT, 4))
    even = _even(COUNT, 5)
    density = np.exp(np.asarray(flow.log_density(even), np.float64))
    for first, second in ((0, 2), (1, 3)):

        def cells(points, first=first, second=second):
            index = np.minimum((np.asarray(points) * bins).astype(int), bins - 1)
            return index[:, first] * bins + index[:, second]

        found = np.bincount(cells(x), minlength=bins**2)
        wanted = np.bincount(cells(even), density, bins**2)
        variance = found + np.bincount(cells(even), density**2, bins**2)
        kept = found > 10
        statistic = ((found - wanted)[kept] ** 2 / variance[kept]).sum()
        assert stats.chi2.sf(statistic, kept.sum()) > 1e-4


@pytest.fixture(scope="module")
def rays():
    """Light of two small balls: red to the left, twice as much green to the right."""
    random, count = np.random.default_rng(5), 1 << 16
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    right = random.random(count) < 0.5
    origin = 0.1 * random.uniform(-1, 1, (count, 3))
    origin[:, 0] += np.where(right, 0.5, -0.5)
    flux = np.where(right[:, None], [0, 2.0, 0], [1.0, 0, 0]) / count
    arrays = (each.astype(np.float32) for each in (origin, direction, flux))
    return TracedRays(*arrays, HALF)


def test_rays_and_coordinates_are_the_same(mi):
    import drjit as dr

    from benchmarks.baselines.light_flow import coordinates, rays_of

    x = np.random.default_rng(6).random((5000, 4), np.float32)
    radius = float(np.linalg.norm(HALF))
    origin, direction = rays_of(x, radius)
    assert np.array(dr.norm(origin)) == pytest.approx(radius, abs=1e-5)
    assert np.array(dr.dot(origin, direction)).max() < 1e-5
    np.testing.assert_allclose(coordinates(origin, direction, radius), x, atol=2e-3)
    # They are those of a line: any of its points gives them.
    moved = origin + 1.3 * direction
    np.testing.assert_allclose(coordinates(moved, direction, radius), x, atol=2e-3)


@pytest.mark.slow
def test_a_flow_learns_where_light_comes_from(mi, rays):
    import drjit as dr

    from benchmarks.baselines.light_flow import BLACK, LightFlow, coordinates, rays_of

    made, count = LightFlow(rays, seed=0, steps=600), 1 << 16
    drawn = made.draw(count, 1)
    origin, direction = drawn.origin, drawn.direction
    found = np.array(drawn.flux, np.float64)
    np.testing.assert_allclose(found.sum(), rays.flux.sum(dtype=np.float64), rtol=1e-3)
    np.testing.assert_allclose(found.sum(axis=1), made.flux, rtol=0.03, atol=0.02)
    for channel, side in ((0, -0.5), (1, 0.5)):
        offset = mi.Vector3f(origin) - mi.Vector3f(side, 0, 0)
        nearest = np.array(dr.norm(dr.cross(offset, direction)))
        light = found[channel]
        # The ball's lines are a 50th of all lines of the sphere.
        assert (light * (nearest < 0.3)).sum() / light.sum() > 0.5
    # The small network has the flow's radiance: most of the variance of its logarithm.
    x = np.random.default_rng(7).random((4096, 4), np.float32)
    x[::2] = coordinates(origin, direction, float(np.linalg.norm(HALF)))[:4096:2]
    distilled = np.log(np.array(made.eval(*rays_of(x, float(np.linalg.norm(HALF)))), np.float64).T)
    wanted = made.log_radiance(x)
    dark = np.log(made.flux[:2] / (4 * np.pi**2 * np.linalg.norm(HALF) ** 2)) - BLACK
    wanted = np.maximum(wanted[:, :2], dark)
    left = ((distilled[:, :2] - wanted) ** 2).mean() / wanted.var()
    assert left < 0.3
    toward = mi.Point3f(0.5, 3, 0), mi.Vector3f(0, -1, 0)
    past = mi.Point3f(0.0, 3, 0.3), mi.Vector3f(0, -1, 0)
    bright, dark = (np.array(made.eval(*ray)).ravel() for ray in (toward, past))
    assert bright[1] > 10 * bright[0]
    assert bright[1] > 5 * dark.max()
