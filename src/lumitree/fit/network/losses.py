"""The training loss (Eq. 7 to 9), and the PSNR that is reported during training."""

import jax
import jax.numpy as jnp

from lumitree.fit.network.config import TrainConfig
from lumitree.fit.network.volume import Composite

# The regulariser of Eq. 8, radiance units.
EPSILON = 0.01


def hdr_loss(
    predicted: jax.Array, radiance: jax.Array, max_radiance: float, stop_gradient: bool
) -> jax.Array:
    """Relative squared error of HDR radiance (Eq. 8), the mean over rays.

    As in the paper, the error is that of radiance / L_max, and the denominator is in radiance
    units. If the error were in radiance units too, this term would be L_max² times larger, and the
    opacity loss would have no effect; see docs/decisions/network.md.

    Args:
        predicted: [R, 3] radiance, >= 0.
        radiance: [R, 3] captured radiance, >= 0.
        max_radiance: L_max, > 0.
        stop_gradient: treat the denominator as constant in the gradient. The minimum over noisy
            captures is then their mean; otherwise it is biased towards higher radiance.
    """
    denominator = jax.lax.stop_gradient(predicted) if stop_gradient else predicted
    error = (predicted - radiance) / max_radiance / (denominator + EPSILON)
    return jnp.mean(jnp.sum(error**2, axis=-1))


def colour_loss(
    predicted: jax.Array, radiance: jax.Array, max_radiance: float, config: TrainConfig
) -> jax.Array:
    """The error of colours that the settings choose (`config.ColourLoss`), the mean over rays."""
    if config.colour_loss == "mse":
        error = (predicted - radiance) / max_radiance
        return jnp.mean(jnp.sum(error**2, axis=-1))
    loss = hdr_loss(predicted, radiance, max_radiance, config.stop_gradient)
    return loss * max_radiance**2 if config.colour_loss == "hdr_radiance" else loss


def opacity_loss(predicted: jax.Array, opacity: jax.Array) -> jax.Array:
    """Squared error of opacity [R] (Eq. 9), averaged over rays."""
    return jnp.mean((predicted - opacity) ** 2)


def total_loss(
    coarse: Composite,
    fine: Composite,
    radiance: jax.Array,
    opacity: jax.Array,
    max_radiance: float,
    config: TrainConfig,
) -> jax.Array:
    """L_c + L_f + L_opacity with equal weights (Eq. 7); L_opacity uses the fine network's opacity.

    Without `config.supervise_opacity` L_opacity is left out.
    """
    loss = colour_loss(coarse.radiance, radiance, max_radiance, config)
    loss += colour_loss(fine.radiance, radiance, max_radiance, config)
    return loss + opacity_loss(fine.opacity, opacity) if config.supervise_opacity else loss


def psnr(predicted: jax.Array, radiance: jax.Array, max_radiance: float) -> jax.Array:
    """Peak signal-to-noise ratio of rays [R, 3] in dB, of radiance / L_max clipped to [0, 1]."""
    found, true = (jnp.clip(value / max_radiance, 0, 1) for value in (predicted, radiance))
    return -10 * jnp.log10(jnp.maximum(jnp.mean((found - true) ** 2), 1e-12))
