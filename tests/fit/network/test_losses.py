"""Loss gradients against finite differences, through the whole volume rendering."""

import dataclasses

import jax
import jax.numpy as jnp
import numpy as np
import pytest

from lumitree.core.transmittance import LAWS
from lumitree.fit.network.config import TrainConfig
from lumitree.fit.network.network import composite
from lumitree.fit.network.step import (
    EPSILON,
    colour_loss,
    hdr_loss,
    opacity_loss,
    psnr,
    total_loss,
)
from support.slow import slow_but_sets

NUM_RAYS, NUM_INTERVALS = 3, 5
MAX_RADIANCE = 1.7


def _loss(raw, law, stop_gradient, frozen=None):
    """The total loss of fields made from `raw`; `frozen` replaces the denominators' radiance."""
    density = 0.3 * jnp.exp(raw[..., 0])
    phi = 2 * jax.nn.sigmoid(raw[..., 1:])
    widths = jnp.linspace(0.05, 0.2, NUM_INTERVALS) * jnp.ones((NUM_RAYS, 1))
    coarse = composite(density, phi, widths, law)
    fine = composite(2 * density, phi, widths, law)
    radiance = jnp.linspace(0.0, 1.5, NUM_RAYS * 3).reshape(NUM_RAYS, 3)
    opacity = jnp.linspace(0.1, 0.9, NUM_RAYS)
    config = TrainConfig(stop_gradient=stop_gradient)
    if frozen is None:
        return (
            total_loss(coarse, fine, radiance, opacity, MAX_RADIANCE, config),
            (coarse, fine),
        )
    terms = [
        (((seen.radiance - radiance) / MAX_RADIANCE / (held + EPSILON)) ** 2).sum(axis=-1).mean()
        for seen, held in zip((coarse, fine), frozen, strict=True)
    ]
    return sum(terms) + ((fine.opacity - opacity) ** 2).mean(), (coarse, fine)


@pytest.mark.parametrize(
    ("law", "stop_gradient"),
    slow_but_sets([("exponential", True), ("linear", False)], LAWS, (True, False)),
)
def test_gradient_matches_finite_differences(law, stop_gradient):
    with jax.enable_x64(True):
        raw = jnp.asarray(np.random.default_rng(5).normal(size=(NUM_RAYS, NUM_INTERVALS, 4)))
        (_, seen), gradient = jax.value_and_grad(_loss, has_aux=True)(raw, law, stop_gradient)
        # Saturated rays have another gradient on purpose: the test after this one.
        assert float(seen[1].opacity.max()) < 0.99
        frozen = tuple(result.radiance for result in seen) if stop_gradient else None
        value = jax.jit(lambda raw: _loss(raw, law, stop_gradient, frozen)[0])
        step = 1e-6
        numeric = np.zeros(raw.shape)
        for index in np.ndindex(raw.shape):
            ends = [value(raw.at[index].add(sign * step)) for sign in (1, -1)]
            numeric[index] = (ends[0] - ends[1]) / (2 * step)
    assert np.abs(numeric).max() > 1e-3
    np.testing.assert_allclose(gradient, numeric, rtol=1e-5, atol=1e-7)


def test_saturated_ray_is_thinned_only_where_it_should_be():
    def loss(density, target):
        phi = jnp.ones((1, 4, 3))
        seen = composite(density, phi, jnp.ones((1, 4)), "linear")
        return opacity_loss(seen.opacity, jnp.array([target]))

    saturated = jnp.full((1, 4), 2.0)
    assert (jax.grad(loss)(saturated, 0.25) > 0.1).all()
    assert (jax.grad(loss)(saturated, 1.0) == 0).all()


def test_hdr_loss_has_its_error_in_unit_range_and_its_denominator_in_radiance():
    predicted, radiance = jnp.array([[1.0, 2.0, 0.0]]), jnp.array([[0.5, 2.0, 0.01]])
    expected = (0.125 / 1.01) ** 2 + 0 + (0.0025 / 0.01) ** 2
    np.testing.assert_allclose(hdr_loss(predicted, radiance, 4.0, True), expected, rtol=1e-6)


def test_frozen_denominator_is_unbiased_under_noise():
    # Captures of 1 and 3, equally often: the gradient vanishes at their mean only when frozen.
    def gradient(stop_gradient):
        noisy = jnp.array([[1.0, 1.0, 1.0], [3.0, 3.0, 3.0]])
        return jax.grad(lambda x: hdr_loss(x * jnp.ones((2, 3)), noisy, 1.0, stop_gradient))(2.0)

    assert abs(float(gradient(True))) < 1e-6
    assert abs(float(gradient(False))) > 1e-2


def test_psnr_of_a_known_error():
    np.testing.assert_allclose(
        psnr(jnp.full((4, 3), 0.4), jnp.full((4, 3), 0.2), 2.0), 20, rtol=1e-5
    )
    # Both are clipped at max_radiance.
    assert float(psnr(jnp.full((1, 3), 9.0), jnp.full((1, 3), 5.0), 2.0)) > 100


def test_the_terms_of_the_loss_that_the_settings_choose():
    """The three rows of the paper's Table 2, and radiance units in numerator and denominator."""
    rng = np.random.default_rng(8)
    shapes = (NUM_RAYS, NUM_INTERVALS), (NUM_RAYS, NUM_INTERVALS, 3), (NUM_RAYS, NUM_INTERVALS)
    coarse, fine = (
        composite(*(jnp.asarray(rng.random(shape)) for shape in shapes), "linear") for _ in range(2)
    )
    radiance, opacity = rng.random((NUM_RAYS, 3)), rng.random(NUM_RAYS)
    settings = TrainConfig()

    def loss(**changes):
        config = dataclasses.replace(settings, **changes)
        return float(total_loss(coarse, fine, radiance, opacity, MAX_RADIANCE, config))

    squares = [
        np.sum((np.asarray(seen.radiance) - radiance) ** 2, axis=-1) for seen in (coarse, fine)
    ]
    mse = sum(np.mean(square) for square in squares) / MAX_RADIANCE**2
    assert loss(colour_loss="mse", supervise_opacity=False) == pytest.approx(mse, rel=1e-5)
    alone = loss(supervise_opacity=False)
    hdr = [hdr_loss(seen.radiance, radiance, MAX_RADIANCE, True) for seen in (coarse, fine)]
    assert alone == pytest.approx(float(sum(hdr)), rel=1e-5)
    assert loss() - alone == pytest.approx(float(opacity_loss(fine.opacity, opacity)), rel=1e-4)
    units = dataclasses.replace(settings, colour_loss="hdr_radiance")
    assert float(colour_loss(fine.radiance, radiance, MAX_RADIANCE, units)) == pytest.approx(
        float(hdr[1]) * MAX_RADIANCE**2, rel=1e-5
    )
