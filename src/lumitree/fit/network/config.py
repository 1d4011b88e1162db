"""Settings of the paper's network and of its training."""

import dataclasses
import math
from typing import Literal, get_args

from lumitree.core.arguments import check_choice, check_count
from lumitree.core.harmonics import MAX_L
from lumitree.core.transmittance import EMISSION_WEIGHTS, LAWS, EmissionWeights, Law
from lumitree.errors import LumitreeError
from lumitree.lamp.dataset import OPACITY_KINDS, OpacityKind

# Error of a colour (Eq. 8). "hdr": error of radiance / L_max, relative to the predicted radiance;
# "hdr_radiance": the same with the error in radiance units; "mse": squared error of
# radiance / L_max, as in NeRF.
ColourLoss = Literal["hdr", "hdr_radiance", "mse"]
COLOUR_LOSSES: tuple[ColourLoss, ...] = get_args(ColourLoss)

# The highest frequency is 2^(n-1) half-periods per local unit. Single precision does not resolve
# 2^16.
MAX_FREQUENCIES = 16

# Settings may come from a file, whose sizes are checked before memory is reserved for them.
_HIGHEST = {
    "num_layers": 64,
    "width": 4096,
    "output_width": 4096,
    "num_coarse": 4096,
    "num_fine": 4096,
    "rays_per_batch": 2**20,
    "num_steps": 2**31 - 1,
}


@dataclasses.dataclass(frozen=True)
class TrainConfig:
    """Settings of the network and its training; the defaults are the paper's (sections 4.2 to 4.4).

    A step with the defaults takes 3.6 s on two CPU cores: they are for a GPU.

    Attributes:
        num_layers: hidden layers of each of the two networks, 1 to 64.
        width: neurons in a hidden layer, 1 to 4,096.
        output_width: neurons in the extra layer before the coefficients, 1 to 4,096.
        num_frequencies: octaves of the Fourier features, 0 to 16.
        num_coarse: intervals per ray of the coarse network, N_c, 1 to 4,096.
        num_fine: additional intervals per ray of the fine network, N_f, 1 to 4,096.
        rays_per_batch: rays in one step, 1 to 2²⁰.
        l_max: highest band of the spherical harmonics, 0 to 4.
        num_steps: steps of the whole run, 1 to 2³¹ - 1.
        learning_rate_start: Adam's step size at the first step.
        learning_rate_end: step size at the last step; it decays exponentially in between.
        law: transmittance law.
        opacity_kind: which captured opacity supervises the field.
        skip_empty: sample only inside the visual hull of the masks.
        stop_gradient: no gradient through the denominator of the HDR loss.
        colour_loss: error of a colour, see `ColourLoss`. Others than "hdr" are for comparison.
        supervise_opacity: whether the loss has the term of the opacity (Eq. 9).
        emission_weights: weights of the emission along a ray; "literal" is for comparison, and
            no asset can store such a field.

    Raises:
        LumitreeError: a setting is out of range.
    """

    num_layers: int = 8
    width: int = 256
    output_width: int = 128
    num_frequencies: int = 10
    num_coarse: int = 64
    num_fine: int = 128
    rays_per_batch: int = 1024
    l_max: int = 2
    num_steps: int = 700_000
    learning_rate_start: float = 5e-4
    learning_rate_end: float = 5e-6
    law: Law = "linear"
    opacity_kind: OpacityKind = "straight_through"
    skip_empty: bool = False
    stop_gradient: bool = True
    colour_loss: ColourLoss = "hdr"
    supervise_opacity: bool = True
    emission_weights: EmissionWeights = "decrease"

    def __post_init__(self) -> None:
        check_choice("law", self.law, LAWS)
        check_choice("opacity_kind", self.opacity_kind, OPACITY_KINDS)
        check_choice("colour_loss", self.colour_loss, COLOUR_LOSSES)
        check_choice("emission_weights", self.emission_weights, EMISSION_WEIGHTS)
        for name, highest in _HIGHEST.items():
            check_count(name, getattr(self, name), 1, highest)
        check_count("num_frequencies", self.num_frequencies, 0, MAX_FREQUENCIES)
        check_count("l_max", self.l_max, 0, MAX_L)
        start, end = self.learning_rate_start, self.learning_rate_end
        if not (math.isfinite(start) and 0 < end <= start):
            raise LumitreeError(
                f"learning rates {start} to {end} do not decay; expected 0 < end <= start"
            )

    @staticmethod
    def preview() -> "TrainConfig":
        """A rough field in about two minutes on two CPU cores."""
        # Many small batches give a better result than few large ones: after 60 s, 24.1 dB with 256
        # rays and 23.2 dB with 1024. After so few steps the exponential law is 1 to 2 dB better
        # than the paper's.
        return TrainConfig(
            law="exponential",
            num_layers=4,
            width=64,
            output_width=64,
            num_frequencies=8,
            num_coarse=16,
            num_fine=24,
            rays_per_batch=256,
            num_steps=3600,
            learning_rate_start=1e-2,
            learning_rate_end=3e-4,
            skip_empty=True,
        )
