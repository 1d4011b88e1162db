"""A distribution of directions from a receiver towards a sphere, by cells of equal solid angle.

The cone of directions towards the sphere (radius R, about the origin) is divided into `rings`
intervals of its cosine and `sectors` of the azimuth about its axis. Within a cell directions are
uniform.
"""

import jax
import jax.numpy as jnp

# Part of the samples that are uniform over the cone, so that the density is nowhere 0.
UNIFORM_SHARE = 0.1


def sample_cells(
    logits: jax.Array, receivers: jax.Array, radius: float, rings: int, key: jax.Array
) -> tuple[jax.Array, jax.Array]:
    """A direction for each receiver, and its density.

    Args:
        logits: [N, rings · sectors] of the cells.
        receivers: [N, 3], outside the sphere.
        radius: R.
        key: PRNG key.

    Returns:
        [N, 3] unit directions from the receivers, and [N] densities by solid angle.
    """
    sectors = logits.shape[-1] // rings
    chosen, place = jax.random.split(key)
    cell = jax.random.categorical(chosen, jnp.log(probabilities(logits)))
    offset = jax.random.uniform(place, (len(receivers), 2))
    ring = (cell // sectors + offset[:, 0]) / rings
    sector = (cell % sectors + offset[:, 1]) / sectors
    directions = cone_directions(receivers, radius, ring, sector)
    part = jnp.take_along_axis(probabilities(logits), cell[:, None], axis=-1)[:, 0]
    return directions, part * logits.shape[-1] / solid_angle(receivers, radius)


def density_of_cells(
    logits: jax.Array, receivers: jax.Array, directions: jax.Array, radius: float, rings: int
) -> jax.Array:
    """Density [N] with which `sample_cells` returns unit directions [N, 3]; 0 past the cone."""
    sectors = logits.shape[-1] // rings
    axis, side, up = _frames(receivers)
    cosine = jnp.sum(directions * axis, axis=-1)
    ring = (1 - cosine) / _cap(receivers, radius)
    azimuth = jnp.arctan2(jnp.sum(directions * up, axis=-1), jnp.sum(directions * side, axis=-1))
    sector = azimuth / (2 * jnp.pi) % 1
    cell = jnp.clip((ring * rings).astype(jnp.int32), 0, rings - 1) * sectors
    cell += jnp.clip((sector * sectors).astype(jnp.int32), 0, sectors - 1)
    part = jnp.take_along_axis(probabilities(logits), cell[:, None], axis=-1)[:, 0]
    density = part * logits.shape[-1] / solid_angle(receivers, radius)
    return jnp.where(ring < 1, density, 0)


def cone_directions(
    receivers: jax.Array, radius: float, ring: jax.Array, sector: jax.Array
) -> jax.Array:
    """Unit directions [N, 3] at places [N] in [0, 1] of the cone's solid angle and azimuth."""
    axis, side, up = _frames(receivers)
    one_minus_cosine = (_cap(receivers, radius) * ring)[:, None]
    sine = jnp.sqrt(one_minus_cosine * (2 - one_minus_cosine))
    azimuth = (2 * jnp.pi * sector)[:, None]
    across = jnp.cos(azimuth) * side + jnp.sin(azimuth) * up
    return (1 - one_minus_cosine) * axis + sine * across


def probabilities(logits: jax.Array) -> jax.Array:
    """Probabilities of the cells, with the uniform share."""
    return (1 - UNIFORM_SHARE) * jax.nn.softmax(logits) + UNIFORM_SHARE / logits.shape[-1]


def solid_angle(receivers: jax.Array, radius: float) -> jax.Array:
    """Solid angle [N] of the cone."""
    return 2 * jnp.pi * _cap(receivers, radius)


def _cap(receivers: jax.Array, radius: float) -> jax.Array:
    """1 - cosine of the cone's half angle, without cancellation."""
    sine_squared = radius**2 / jnp.sum(receivers**2, axis=-1)
    return sine_squared / (1 + jnp.sqrt(jnp.maximum(1 - sine_squared, 0)))


def _frames(receivers: jax.Array) -> tuple[jax.Array, jax.Array, jax.Array]:
    """Axis of the cone and two vectors across it [N, 3] (Duff et al. 2017)."""
    axis = -receivers / jnp.linalg.norm(receivers, axis=-1, keepdims=True)
    x, y, z = axis[:, 0], axis[:, 1], axis[:, 2]
    sign = jnp.where(z < 0, -1.0, 1.0)
    a = -1 / (sign + z)
    b = x * y * a
    side = jnp.stack([1 + sign * x * x * a, sign * b, -sign * x], axis=-1)
    up = jnp.stack([b, sign + y * y * a, -y], axis=-1)
    return axis, side, up
