"""NeRF-SH: the network from position to density and emission, and volume rendering (Eq. 3 to 6).

Symbols
    N            positions
    K            (l_max + 1)² coefficients of a colour channel
    density      sigma, per local unit length, >= 0
    emission     Phi, radiance per unit of opacity, in (0, max_radiance)
    position     local frame, each coordinate in [-1, 1]
    t            distance along a ray, local units
    s            occupied length of a ray up to t, in [0, S]; S is the total
    edges        [R, N + 1] increasing values of s; interval i lies between edges i and i + 1
    widths       [R, N] lengths of the intervals; they partition [0, S]
    tau          optical depth; T transmittance; weight w_i = T_i - T_{i+1}
"""

import math
from typing import NamedTuple

import jax
import jax.numpy as jnp
from flax import nnx

from lumitree.core.frames import towards_viewer
from lumitree.core.harmonics import basis, num_coefficients
from lumitree.core.transmittance import EmissionWeights, Law, emission_weights, transmittance
from lumitree.fit.network.config import TrainConfig
from lumitree.fit.network.rays import Occupancy, contains, occupied_bins

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


# Fraction of the fine samples that is distributed uniformly, so that they also reach what the
# coarse network does not represent.
UNIFORM_SHARE = 0.1


class Chord(NamedTuple):
    """The occupied bins of R rays.

    Attributes:
        near: [R] distance at which the ray enters the box.
        bin_length: [R], local units.
        counts: [R, K] number of occupied bins up to and including each bin.
        length: [R] occupied length S.
    """

    near: jax.Array
    bin_length: jax.Array
    counts: jax.Array
    length: jax.Array


class Composite(NamedTuple):
    """Radiance [R, 3] and opacity [R] of R rays, and the weights [R, N] of their intervals."""

    radiance: jax.Array
    opacity: jax.Array
    weights: jax.Array


def occupied_chord(occupancy: Occupancy, origins: jax.Array, directions: jax.Array) -> Chord:
    """The occupied bins of rays [R, 3] (local frame, directions of travel)."""
    occupied, near, bin_length = occupied_bins(occupancy, origins, directions)
    counts = jnp.cumsum(occupied, axis=-1, dtype=jnp.int32)
    return Chord(near, bin_length, counts, counts[:, -1] * bin_length)


def distances(chord: Chord, lengths: jax.Array) -> jax.Array:
    """t(s): distances [R, N] at occupied lengths s [R, N] in [0, S]."""
    bin_length = chord.bin_length[:, None]
    bins = lengths / jnp.maximum(bin_length, 1e-12)
    last = jnp.maximum(chord.counts[:, -1:] - 1, 0)
    whole = jnp.clip(jnp.floor(bins).astype(jnp.int32), 0, last)
    # The bin with `whole` occupied bins before it. On a CPU comparing is faster than searching.
    index = jnp.sum(chord.counts[:, None, :] <= whole[:, :, None], axis=-1)
    return chord.near[:, None] + (index + bins - whole) * bin_length


def stratified_edges(length: jax.Array, num_intervals: int, key: jax.Array | None) -> jax.Array:
    """Edges [R, N + 1] of N intervals of [0, S]: equal, or jittered by up to half an interval.

    Args:
        length: [R] occupied length S.
        key: PRNG key of the jitter; None for equal intervals.
    """
    steps = jnp.broadcast_to(jnp.arange(num_intervals + 1.0), (*length.shape, num_intervals + 1))
    if key is not None:
        jitter = jax.random.uniform(key, (*length.shape, num_intervals - 1)) - 0.5
        steps = steps.at[:, 1:-1].add(jitter)
    return steps / num_intervals * length[:, None]


def importance_samples(
    edges: jax.Array, weights: jax.Array, num_samples: int, key: jax.Array | None
) -> jax.Array:
    """Samples from a piecewise-constant distribution, by its inverse cumulative function.

    Interval i has the probability (1 - UNIFORM_SHARE) w_i / sum(w), plus UNIFORM_SHARE times its
    part of the length. The distribution is uniform if all weights are 0. Returns [R, M] increasing
    values of s, without gradient, stratified; centres of the strata without a key.

    Args:
        edges: [R, N + 1].
        weights: [R, N], >= 0.
    """
    edges, weights = jax.lax.stop_gradient((edges, weights))
    widths = jnp.diff(edges, axis=-1)
    length = edges[:, -1:] - edges[:, :1]
    total = jnp.sum(weights, axis=-1, keepdims=True)
    share = jnp.where(total > 1e-6, UNIFORM_SHARE, 1.0)
    mass = (1 - share) * weights / jnp.maximum(total, 1e-6)
    mass += share * widths / jnp.maximum(length, 1e-12)
    cumulative = jnp.cumsum(mass, axis=-1)
    cumulative = jnp.pad(cumulative[:, :-1], ((0, 0), (1, 0)))
    shape = (edges.shape[0], num_samples)
    jitter = 0.5 if key is None else jax.random.uniform(key, shape)
    uniform = jnp.broadcast_to((jnp.arange(num_samples) + jitter) / num_samples, shape)
    index = jnp.sum(cumulative[:, None, :] <= uniform[:, :, None], axis=-1) - 1

    def pick(values: jax.Array) -> jax.Array:
        return jnp.take_along_axis(values, index, axis=-1)

    part = (uniform - pick(cumulative)) / jnp.maximum(pick(mass), 1e-12)
    return pick(edges[:, :-1]) + jnp.clip(part, 0, 1) * pick(widths)


def composite(
    density: jax.Array,
    phi: jax.Array,
    widths: jax.Array,
    law: Law,
    kind: EmissionWeights = "decrease",
) -> Composite:
    """Radiance and opacity of intervals with constant density and emission (Eq. 3 to 5).

    Args:
        density: [R, N], >= 0, per local unit.
        phi: [R, N, 3] emission.
        widths: [R, N] local units.
    """
    tau = jnp.cumsum(density * widths, axis=-1)
    after = transmittance(tau, law, jnp)
    before = jnp.pad(after[:, :-1], ((0, 0), (1, 0)), constant_values=1.0)
    weights = emission_weights(before, after, law, kind)
    opacity = 1 - after[:, -1]
    if law == "linear":
        opacity = _through_saturation(opacity, tau[:, -1])
    return Composite(jnp.sum(weights[..., None] * phi, axis=1), opacity, weights)


def _through_saturation(opacity: jax.Array, tau: jax.Array) -> jax.Array:
    """The linear law's opacity min(tau, 1), with the gradient of tau also where it is 1.

    The true gradient there is 0, so a ray whose opacity is wrongly 1 would keep it. An opacity of 1
    can only be too large, so this gradient can only decrease the density along such a ray.
    """
    return tau + jax.lax.stop_gradient(opacity - tau)


def march(
    network: NerfSH,
    occupancy: Occupancy,
    chord: Chord,
    origins: jax.Array,
    directions: jax.Array,
    edges: jax.Array,
    max_radiance: float,
    config: TrainConfig,
) -> Composite:
    """Evaluate one network at the centres of the intervals, and integrate along the rays."""
    middles = distances(chord, (edges[:, 1:] + edges[:, :-1]) / 2)
    positions = origins[:, None, :] + middles[..., None] * directions[:, None, :]
    density, coefficients = network(positions)
    # As in the exported field (`trained_field`), density is 0 outside of the grid.
    density = jnp.where(contains(occupancy, positions), density, 0)
    phi = emission(coefficients, directions, max_radiance)
    widths = jnp.diff(edges, axis=-1)
    return composite(density, phi, widths, config.law, config.emission_weights)


def render(
    networks: CoarseAndFine,
    occupancy: Occupancy,
    origins: jax.Array,
    directions: jax.Array,
    max_radiance: float,
    config: TrainConfig,
    key: jax.Array | None,
) -> tuple[Composite, Composite]:
    """Radiance and opacity of rays by both networks (hierarchical sampling of NeRF).

    Args:
        networks: both networks.
        occupancy: cells outside of which density is 0.
        origins, directions: [R, 3] local frame; unit directions of travel.
        max_radiance: L_max.
        config: numbers of intervals, and the transmittance law.
        key: PRNG key of the jitter; None for no jitter.

    Returns:
        The coarse result on `num_coarse` intervals, the fine one on `num_coarse + num_fine`.
    """
    coarse_key, fine_key = (None, None) if key is None else jax.random.split(key)
    chord = occupied_chord(occupancy, origins, directions)

    def render_one(network: NerfSH, edges: jax.Array) -> Composite:
        return march(network, occupancy, chord, origins, directions, edges, max_radiance, config)

    edges = stratified_edges(chord.length, config.num_coarse, coarse_key)
    coarse = render_one(networks.coarse, edges)
    samples = importance_samples(edges, coarse.weights, config.num_fine, fine_key)
    edges = jnp.sort(jnp.concatenate([edges, samples], axis=-1), axis=-1)
    return coarse, render_one(networks.fine, edges)
