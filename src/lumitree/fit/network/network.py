"""NeRF-SH: the network from position to density and spherical-harmonics emission.

Symbols
    N            positions
    K            (l_max + 1)² coefficients of a colour channel
    density      sigma, per local unit length, >= 0
    emission     Phi, radiance per unit of opacity, in (0, max_radiance)
    position     local frame, each coordinate in [-1, 1]
"""

import math

import jax
import jax.numpy as jnp
from flax import nnx

from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis, num_coefficients
from lumitree.fit.network.config import TrainConfig

# density = DENSITY_SCALE * softplus(x - DENSITY_SHIFT). With this scale, outputs of order 10 give
# the density of 128 per unit that an opaque surface needs in a leaf of side 1/128. With this shift,
# the initial density is about 3, so a ray through the visual hull is initially neither transparent
# nor saturated. Under the linear law, nothing behind optical depth 1 receives a gradient. From a
# far lower initial density, the HDR loss first produces a thin, bright fog, and opacity is learnt
# late: the opacity error after 300 steps of `preview` is then 0.56 instead of 0.34.
DENSITY_SCALE = 30.0
DENSITY_SHIFT = 2.3


def fourier_features(positions: jax.Array, num_frequencies: int) -> jax.Array:
    """Positions [N, 3] with sin and cos of 2^k pi x for k < num_frequencies (NeRF, Eq. 4).

    Each octave is computed from the one before it by the double-angle formulas.
    """
    features = [positions]
    sine, cosine = jnp.sin(jnp.pi * positions), jnp.cos(jnp.pi * positions)
    for _ in range(num_frequencies):
        features += [sine, cosine]
        sine, cosine = 2 * sine * cosine, 1 - 2 * sine * sine
    return jnp.concatenate(features, axis=-1)


class NerfSH(nnx.Module):
    """One network: position to density and coefficients (Sec. 4.2, "Network architecture").

    `initial_emission` is the constant emission before training, as a fraction of max_radiance in
    (0, 1). It should be typical of the luminaire, which is far below 1 for HDR radiance: the loss
    divides by the prediction, so too strong an emission decreases slowly.
    """

    def __init__(self, config: TrainConfig, initial_emission: float, rngs: nnx.Rngs) -> None:
        self.num_frequencies = config.num_frequencies
        self.num_coefficients = num_coefficients(config.l_max)
        # As in NeRF, the input is concatenated again in the middle; not in shallow networks.
        self.skip_layer = config.num_layers // 2 if config.num_layers >= 6 else None
        num_features = 3 + 6 * config.num_frequencies
        init = nnx.initializers.he_normal()
        layers = []
        for index in range(config.num_layers):
            inputs = num_features if index == 0 else config.width
            inputs += num_features if index == self.skip_layer else 0
            layers.append(nnx.Linear(inputs, config.width, kernel_init=init, rngs=rngs))
        self.layers = nnx.List(layers)
        self.density_head = nnx.Linear(config.width, 1, rngs=rngs)
        self.output_layer = nnx.Linear(
            config.width, config.output_width, kernel_init=init, rngs=rngs
        )
        self.coefficient_head = nnx.Linear(
            config.output_width,
            3 * self.num_coefficients,
            kernel_init=nnx.initializers.normal(0.01),
            bias_init=lambda *_: _constant_coefficients(initial_emission, self.num_coefficients),
            rngs=rngs,
        )

    def __call__(self, positions: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Density [N] and coefficients [N, 3, K] at positions [N, 3]."""
        features = fourier_features(positions, self.num_frequencies)
        trunk = features
        for index, layer in enumerate(self.layers):
            if index == self.skip_layer:
                trunk = jnp.concatenate([trunk, features], axis=-1)
            trunk = nnx.relu(layer(trunk))
        raw = self.density_head(trunk)[..., 0]
        density = DENSITY_SCALE * nnx.softplus(raw - DENSITY_SHIFT)
        coefficients = self.coefficient_head(nnx.relu(self.output_layer(trunk)))
        return density, coefficients.reshape(*density.shape, 3, self.num_coefficients)


class CoarseAndFine(nnx.Module):
    """The two networks of NeRF; the weights of `coarse` determine where `fine` is sampled."""

    def __init__(self, config: TrainConfig, initial_emission: float, seed: int) -> None:
        rngs = nnx.Rngs(seed)
        self.coarse = NerfSH(config, initial_emission, rngs)
        self.fine = NerfSH(config, initial_emission, rngs)


def emission(coefficients: jax.Array, directions: jax.Array, max_radiance: float) -> jax.Array:
    """Emission with the extended-range sigmoid, max_radiance * sigmoid(sum of c Y) (Eq. 6).

    Args:
        coefficients: [R, N, 3, K] of N positions on each of R rays.
        directions: [R, 3] unit directions of travel.
        max_radiance: L_max, > 0.

    Returns:
        [R, N, 3] radiance towards the viewer.
    """
    l_max = math.isqrt(coefficients.shape[-1]) - 1
    x, y, z = (towards_viewer(directions)[..., axis] for axis in range(3))
    harmonics = jnp.stack(basis(x, y, z, l_max), axis=-1)
    logits = jnp.sum(coefficients * harmonics[:, None, None, :], axis=-1)
    return max_radiance * nnx.sigmoid(logits)


def _constant_coefficients(part: float, count: int) -> jax.Array:
    """Coefficients [3 count] of the constant emission part * max_radiance."""
    constant_band = basis(0.0, 0.0, 1.0, 0)[0]
    value = math.log(part / (1 - part)) / constant_band
    return jnp.zeros((3, count)).at[:, 0].set(value).ravel()
