"""The network's inputs, ranges and starting point."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx

from lumitree.core.harmonics import basis_array
from lumitree.fit.network.config import TrainConfig
from lumitree.fit.network.network import NerfSH, emission, fourier_features

POSITIONS = jnp.asarray(np.random.default_rng(0).uniform(-1, 1, (500, 3)), jnp.float32)


def test_octaves_by_double_angles():
    features = np.asarray(fourier_features(POSITIONS, 10))
    angles = np.pi * np.asarray(POSITIONS, np.float64)
    expected = [np.asarray(POSITIONS)]
    for octave in range(10):
        expected += [np.sin(2**octave * angles), np.cos(2**octave * angles)]
    np.testing.assert_allclose(features, np.concatenate(expected, axis=-1), atol=1e-3)


def test_shapes_of_the_papers_network():
    config = TrainConfig()
    network = nnx.eval_shape(lambda: NerfSH(config, 0.02, nnx.Rngs(0)))
    kernels = [layer.kernel.shape for layer in network.layers]
    assert kernels == [(63, 256), *[(256, 256)] * 3, (319, 256), *[(256, 256)] * 3]
    assert network.output_layer.kernel.shape == (256, 128)
    assert network.coefficient_head.kernel.shape == (128, 27)


def test_field_starts_half_clear_and_dim():
    config = dataclasses.replace(TrainConfig.preview(), l_max=1)
    density, coefficients = NerfSH(config, 0.02, nnx.Rngs(0))(POSITIONS)
    assert density.shape == (500,)
    assert coefficients.shape == (500, 3, 4)
    # A ray spends a fraction of a unit in the hull: neither clear nor saturated there.
    assert 0.5 < float(density.mean()) < 8
    phi = emission(coefficients[None], jnp.array([[0.0, 0.6, 0.8]]), 10.0)
    np.testing.assert_allclose(phi.mean(), 0.2, rtol=0.2)


def test_emission_is_evaluated_towards_the_viewer():
    rng = np.random.default_rng(1)
    coefficients = rng.normal(size=(2, 3, 3, 9)).astype(np.float32)
    directions = rng.normal(size=(2, 3))
    directions /= np.linalg.norm(directions, axis=-1, keepdims=True)
    logits = np.einsum("rnck,rk->rnc", coefficients, basis_array(-directions, 2))
    np.testing.assert_allclose(
        emission(jnp.asarray(coefficients), jnp.asarray(directions, jnp.float32), 7.0),
        7 / (1 + np.exp(-logits)),
        rtol=1e-4,
    )


def test_gradients_reach_every_weight():
    config = dataclasses.replace(TrainConfig.preview(), width=8)
    graph, params = nnx.split(NerfSH(config, 0.02, nnx.Rngs(0)))

    @jax.jit
    def total(params):
        density, coefficients = nnx.merge(graph, params)(POSITIONS)
        return density.sum() + (coefficients**2).sum()

    gradients = jax.tree.leaves(jax.grad(total)(params))
    assert len(gradients) == 14
    assert all(float(jnp.abs(gradient).max()) > 0 for gradient in gradients)
