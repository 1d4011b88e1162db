"""Volume rendering: laws, closed forms, sampling."""

import jax
import jax.numpy as jnp
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from lumitree.core.transmittance import LAWS
from lumitree.fit.network import network as volume
from lumitree.fit.network.network import UNIFORM_SHARE, importance_samples, stratified_edges
from lumitree.fit.network.rays import Occupancy, full_occupancy

NUM_RAYS, NUM_INTERVALS = 4, 9

composite = jax.jit(volume.composite, static_argnums=3)
occupied_chord = jax.jit(volume.occupied_chord)
distances = jax.jit(volume.distances)


@pytest.mark.parametrize("law", LAWS)
@settings(max_examples=40)
@given(
    density=arrays(np.float32, (NUM_RAYS, NUM_INTERVALS), elements=st.floats(0, 100, width=32)),
    widths=arrays(np.float32, (NUM_RAYS, NUM_INTERVALS), elements=st.floats(0, 0.5, width=32)),
)
def test_weights_are_positive_and_sum_to_opacity(law, density, widths):
    phi = jnp.ones((NUM_RAYS, NUM_INTERVALS, 3))
    result = composite(density, phi, widths, law)
    assert np.all(np.asarray(result.weights) >= 0)
    np.testing.assert_allclose(result.weights.sum(axis=-1), result.opacity, atol=2e-6)
    # A unit emission shows the opacity itself: nothing is lost and nothing doubled.
    np.testing.assert_allclose(result.radiance, result.opacity[:, None].repeat(3, 1), atol=2e-6)


@pytest.mark.parametrize(
    ("law", "opacity"), [("linear", 0.6 * 0.9), ("exponential", 1 - np.exp(-0.6 * 0.9))]
)
def test_a_uniform_slab_matches_its_closed_form_on_any_intervals(law, opacity):
    rng = np.random.default_rng(1)
    for count in (1, 7, 64):
        widths = rng.dirichlet(np.ones(count))[None] * 0.9
        result = composite(
            jnp.full((1, count), 0.6), jnp.full((1, count, 3), 2.5), jnp.asarray(widths), law
        )
        np.testing.assert_allclose(result.opacity, [opacity], rtol=1e-5)
        np.testing.assert_allclose(result.radiance, np.full((1, 3), 2.5 * opacity), rtol=1e-5)


@pytest.mark.parametrize("law", LAWS)
def test_an_opaque_slab_shows_its_front(law):
    density = jnp.array([[0.0, 1e4, 1e4]])
    phi = jnp.stack([jnp.full((1, 3), value) for value in (9.0, 5.0, 1.0)], axis=1)
    result = composite(density, phi, jnp.full((1, 3), 0.1), law)
    np.testing.assert_allclose(result.radiance, np.full((1, 3), 5.0), rtol=1e-6)
    np.testing.assert_allclose(result.opacity, [1.0], rtol=1e-6)


@pytest.mark.parametrize("law", LAWS)
def test_refinement_converges_to_the_integral(law):
    # sigma(t) = t and Phi(t) = t on [0, 1]: tau = t²/2.
    #   linear       integral of sigma Phi        = 1/3
    #   exponential  integral of exp(-t²/2) t² dt = sqrt(pi/2) erf(1/sqrt 2) - exp(-1/2)
    exact = 1 / 3 if law == "linear" else 1.2533141373155 * 0.6826894921371 - np.exp(-0.5)
    errors = []
    for count in (8, 32, 128):
        middles = (jnp.arange(count) + 0.5) / count
        phi = jnp.broadcast_to(middles[None, :, None], (1, count, 3))
        result = composite(middles[None], phi, jnp.full((1, count), 1 / count), law)
        errors.append(abs(float(result.radiance[0, 0]) - exact))
    assert errors[0] < 5e-3
    assert errors[1] < errors[0] / 10
    assert errors[2] < 2e-5


def test_edges_partition_the_occupied_length():
    length = jnp.array([0.0, 0.3, 2.0])
    for key in (None, jax.random.key(3)):
        edges = np.asarray(stratified_edges(length, 16, key))
        assert edges.shape == (3, 17)
        assert np.all(np.diff(edges, axis=-1) >= 0)
        np.testing.assert_allclose(edges[:, 0], 0)
        np.testing.assert_allclose(edges[:, -1], length, rtol=1e-6)


def test_importance_samples_follow_the_weights():
    edges = jnp.array([[0.0, 0.1, 0.4, 0.5, 1.0]])
    weights = np.array([[0.1, 0.0, 0.6, 0.1]])
    repeats = 4000
    samples = importance_samples(
        jnp.tile(edges, (repeats, 1)),
        jnp.tile(jnp.asarray(weights), (repeats, 1)),
        8,
        jax.random.key(0),
    )
    assert np.all(np.diff(samples, axis=-1) >= 0)
    # Twenty equal cells, the density integrated over each.
    cells = np.linspace(0, 1, 21)
    counts = np.histogram(np.asarray(samples), cells)[0] / samples.size
    share = (1 - UNIFORM_SHARE) * weights[0] / weights.sum()
    cdf = np.concatenate([[0], np.cumsum(share + UNIFORM_SHARE * np.diff(edges[0]))])
    expected = np.diff(np.interp(cells, edges[0], cdf))
    # Stratified counts vary less than independent ones, whose deviation is below 0.0025.
    np.testing.assert_allclose(counts, expected, atol=0.005)


def test_importance_samples_are_even_where_nothing_is_seen():
    edges = jnp.array([[0.0, 0.7, 1.0]])
    samples = importance_samples(edges, jnp.zeros((1, 2)), 10, None)
    np.testing.assert_allclose(samples, [(np.arange(10) + 0.5) / 10], atol=1e-6)


def test_importance_samples_carry_no_gradient():
    def spread(weights):
        return importance_samples(jnp.array([[0.0, 0.3, 1.0]]), weights, 4, None).sum()

    assert np.all(jax.grad(spread)(jnp.array([[1.0, 2.0]])) == 0)


def _random_rays(count, seed):
    rng = np.random.default_rng(seed)
    directions = rng.normal(size=(count, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    origins = rng.uniform(-0.5, 0.5, (count, 3)) - 3 * directions
    return jnp.asarray(origins, jnp.float32), jnp.asarray(directions, jnp.float32)


def test_full_box_distances_are_the_chord():
    occupancy = full_occupancy((1.0, 0.6, 0.8))
    origins, directions = _random_rays(64, 0)
    chord = occupied_chord(occupancy, origins, directions)
    s = stratified_edges(chord.length, 8, None)
    t = distances(chord, s)
    np.testing.assert_allclose(t, chord.near[:, None] + s, atol=1e-5)
    for end in (0, -1):
        position = origins + t[:, end, None] * directions
        np.testing.assert_allclose(
            jnp.max(jnp.abs(position / occupancy.half_extents), axis=-1), 1, atol=1e-4
        )


def test_only_empty_stretches_are_skipped():
    cells = np.zeros((64, 64, 64), bool)
    cells[8:20] = cells[40:44] = True
    occupancy = Occupancy(cells, np.ones(3, np.float32))
    # Along x, through the two slabs: bins are cells.
    chord = occupied_chord(occupancy, jnp.array([[-3.0, 0.01, 0.02]]), jnp.array([[1.0, 0.0, 0.0]]))
    np.testing.assert_allclose(chord.length, [16 / 32], rtol=1e-5)
    s = (jnp.arange(160) + 0.5)[None] / 160 * chord.length[:, None]
    x = np.asarray(distances(chord, s))[0] - 3
    cell = np.floor((x + 1) * 32).astype(int)
    assert cells[cell, 0, 0].all()
    assert set(cell) == {*range(8, 20), *range(40, 44)}
    # True lengths: a step in s is a step in t, except across the gap.
    gaps = np.diff(x)
    assert np.sum(np.abs(gaps - 0.5 / 160) > 1e-4) == 1


def test_a_ray_that_misses_the_box_has_no_length():
    occupancy = full_occupancy((1.0, 1.0, 1.0))
    chord = occupied_chord(occupancy, jnp.array([[-3.0, 2.0, 0.0]]), jnp.array([[1.0, 0.0, 0.0]]))
    assert float(chord.length[0]) == 0
    assert np.isfinite(np.asarray(distances(chord, jnp.zeros((1, 3))))).all()
