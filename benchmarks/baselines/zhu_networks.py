"""The networks of Zhu et al. 2021, "Neural Complex Luminaires: Representation and Rendering".

Three networks: `radiance` (view synthesis) and `opacity` (blending) of rays that meet the
luminaire's bounding sphere, and `SamplingNetwork`, which chooses directions for a receiver.

From the public code of the authors' renderer (github.com/VElysianP/Neural_Complex_Luminaire):

* what the networks take: for radiance and opacity the point where a ray enters the sphere, mapped
  to [0, 1]³, and the direction towards the viewer; for sampling the receiver's place relative to
  the luminaire, over the sphere's radius, clipped at 18 radii and divided by 42;
* the body: the features sin(2^i π x), cos(2^i π x) for i < 10 of each input, a layer of 128, five
  residual blocks of two layers of 128, another layer of 128, the output; ReLU;
* radiance is standardised by its mean and its standard deviation.

Guessed, because neither the abstract nor that code says it:

* that the two networks that take 6 inputs, of which only weights in ONNX existed, have the body of
  the older one in the code, which takes 4; and that directions too are mapped to [0, 1] first;
* the encoding of radiance before it is standardised, log(1 + L / 0.01) (`encoding`);
* the losses (squared error of encoded radiance, cross entropy of opacity), Adam, its step sizes
  and the batch; that radiance is clipped at the largest of the training rays;
* what the weights of the sampling network mean: here probabilities of equal solid angles of the
  cone of directions towards the sphere, mixed with 10 % of uniform directions, and trained by
  cross entropy against the radiance network.
"""

import dataclasses
from typing import Literal

import jax
import jax.numpy as jnp
import numpy as np
from flax import nnx
from numpy.typing import NDArray

from lumitree.fit.network.network import fourier_features

Encoding = Literal["log", "linear"]
# Radiance at which the logarithm of the encoding becomes linear: that of the paper's Eq. 8.
_KNEE = 0.01
# Receivers: largest distance, and its scale, in radii of the sphere.
_FARTHEST, _SPAN = 18.0, 42.0


@dataclasses.dataclass(frozen=True)
class ZhuConfig:
    """Sizes of the networks, and how they are trained.

    Attributes:
        width: neurons in a hidden layer.
        blocks: residual blocks.
        position_frequencies, direction_frequencies: octaves of the features of an input.
        encoding: of radiance: its logarithm, or radiance itself.
        rings, sectors: cells of the cone of directions of the sampling network.
        rays_per_batch: rays in one step.
        learning_rate_start, learning_rate_end: Adam's step size.
        seed: root seed.
    """

    width: int = 128
    blocks: int = 5
    position_frequencies: int = 10
    direction_frequencies: int = 10
    encoding: Encoding = "log"
    rings: int = 16
    sectors: int = 32
    rays_per_batch: int = 1024
    learning_rate_start: float = 1e-3
    learning_rate_end: float = 1e-5
    seed: int = 0


class Body(nnx.Module):
    """The residual network that all three have: features [N, F] to outputs [N, O]."""

    def __init__(self, config: ZhuConfig, inputs: int, outputs: int, rngs: nnx.Rngs) -> None:
        init, width = nnx.initializers.he_normal(), config.width

        def layer(fan_in: int) -> nnx.Linear:
            return nnx.Linear(fan_in, width, kernel_init=init, rngs=rngs)

        self.first, self.last = layer(inputs), layer(width)
        self.blocks = nnx.List(
            [nnx.List([layer(width), layer(width)]) for _ in range(config.blocks)]
        )
        # Small at first: each block doubles the variance, and a sigmoid would be saturated.
        small = nnx.initializers.normal(0.01)
        self.output = nnx.Linear(width, outputs, kernel_init=small, rngs=rngs)

    def __call__(self, features: jax.Array) -> jax.Array:
        hidden = nnx.relu(self.first(features))
        for inner, outer in self.blocks:
            hidden = nnx.relu(outer(nnx.relu(inner(hidden))) + hidden)
        return self.output(nnx.relu(self.last(hidden)))


class RayNetworks(nnx.Module):
    """The networks of radiance and of opacity.

    Args:
        config: sizes.
        radius: of the bounding sphere, local units.
        moments: mean and standard deviation of the encoded radiance.
        max_radiance: L_max, the largest radiance that is returned.
        seed: of the initial weights.
    """

    def __init__(
        self,
        config: ZhuConfig,
        radius: float,
        moments: tuple[float, float],
        max_radiance: float,
        seed: int,
    ) -> None:
        rngs = nnx.Rngs(seed)
        inputs = 6 + 6 * (config.position_frequencies + config.direction_frequencies)
        self.radiance = Body(config, inputs, 3, rngs)
        self.opacity = Body(config, inputs, 1, rngs)
        self.config, self.radius = config, radius
        self.mean, self.deviation = moments
        self.max_radiance = max_radiance

    def __call__(self, origins: jax.Array, directions: jax.Array) -> tuple[jax.Array, jax.Array]:
        """Standardised encoded radiance [R, 3], and logits of opacity [R] (`features`)."""
        inputs = self.features(origins, directions)
        return self.radiance(inputs), self.opacity(inputs)[..., 0]

    def features(self, origins: jax.Array, directions: jax.Array) -> jax.Array:
        """Features of rays that meet the sphere: origins, unit directions of travel [R, 3]."""
        point = sphere_entry(origins, directions, self.radius) / self.radius
        position, viewer = ((each + 1) / 2 for each in (point, -directions))
        config = self.config
        return jnp.concatenate(
            [
                fourier_features(position, config.position_frequencies),
                fourier_features(viewer, config.direction_frequencies),
            ],
            axis=-1,
        )

    def standardise(self, radiance: jax.Array) -> jax.Array:
        """What the network of radiance learns."""
        return (encode(radiance, self.config.encoding) - self.mean) / self.deviation

    def decode(self, standardised: jax.Array) -> jax.Array:
        """Radiance in [0, L_max] of what the network returns."""
        encoded = standardised * self.deviation + self.mean
        encoded = jnp.clip(encoded, 0, encode(self.max_radiance, self.config.encoding))
        return _KNEE * jnp.expm1(encoded) if self.config.encoding == "log" else encoded


class SamplingNetwork(nnx.Module):
    """Logits [N, rings · sectors] of the cone's cells for receivers [N, 3], local frame."""

    def __init__(self, config: ZhuConfig, radius: float, seed: int) -> None:
        inputs = 3 + 6 * config.position_frequencies
        self.body = Body(config, inputs, config.rings * config.sectors, nnx.Rngs(seed))
        self.frequencies, self.radius = config.position_frequencies, radius

    def __call__(self, receivers: jax.Array) -> jax.Array:
        place = receivers / self.radius
        distance = jnp.linalg.norm(place, axis=-1, keepdims=True)
        place = place * jnp.minimum(1, _FARTHEST / distance)
        return self.body(fourier_features(place / _SPAN + 0.5, self.frequencies))


def encode(radiance: jax.Array | NDArray[np.floating] | float, encoding: Encoding) -> jax.Array:
    """Radiance, or log(1 + radiance / 0.01)."""
    return jnp.log1p(radiance / _KNEE) if encoding == "log" else jnp.asarray(radiance)


def sphere_entry(origins: jax.Array, directions: jax.Array, radius: float) -> jax.Array:
    """Points [R, 3] where lines enter the sphere about the centre; those that miss it graze it."""
    along = jnp.sum(origins * directions, axis=-1, keepdims=True)
    nearest = origins - along * directions
    half_chord = jnp.sqrt(jnp.maximum(radius**2 - jnp.sum(nearest**2, axis=-1, keepdims=True), 0))
    return nearest - half_chord * directions
