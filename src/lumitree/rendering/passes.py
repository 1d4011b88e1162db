"""Images in passes: of bounded memory, with an estimate of their noise, until a budget is spent.

Symbols
    x_k, n_k    mean radiance of a pixel in pass k, samples per pixel of the pass
    N, K        samples per pixel of all passes, number of passes
"""

from __future__ import annotations

import dataclasses
import time
from collections.abc import Callable
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import MAX_SAMPLES
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError

# Samples a pass, by the backend of Dr.Jit: some seconds of work at most. Progress is shown, and
# Ctrl-C heeded, between passes; a GPU is idle while a pass is prepared.
_SAMPLES_PER_PASS = {dr.JitBackend.LLVM: 1 << 19, dr.JitBackend.CUDA: 1 << 23}
# Passes after which noise is known well enough to stop.
_MIN_PASSES = 8
# Least time between two images that are shown while they are rendered, s, and the largest part of
# the time that showing them takes.
_SECONDS_BETWEEN_IMAGES, _MOST_TIME_OF_IMAGES = 2.0, 0.1
# Samples per pixel of a pass at most, where it is not known how many there will be.
_MAX_SAMPLES_PER_PIXEL = 16


@dataclasses.dataclass(frozen=True)
class Budget:
    """When a render stops: at the first limit that is reached.

    Attributes:
        samples_per_pixel: number of samples, or None.
        seconds: time of rendering, s, or None. One pass is always completed.
        noise: relative noise as `Rendering.noise`, or None. Eight passes are always completed.
    """

    samples_per_pixel: int | None = None
    seconds: float | None = None
    noise: float | None = None

    def __post_init__(self) -> None:
        if self.samples_per_pixel is not None and self.samples_per_pixel < 1:
            raise LumitreeError(f"spp is {self.samples_per_pixel}; expected at least 1")

    def share(self, samples: int, seconds: float, noise: float | None) -> float:
        """Part of the budget that is spent, 0 to 1."""
        shares = [samples / (self.samples_per_pixel or MAX_SAMPLES)]
        if self.seconds is not None:
            shares.append(seconds / self.seconds)
        if self.noise is not None and noise is not None:
            # Noise falls as the root of the number of samples.
            shares.append((self.noise / noise) ** 2 if noise else 1.0)
        return min(1.0, max(shares))


@dataclasses.dataclass(frozen=True)
class Rendering:
    """An image and what is known of it.

    Attributes:
        channels: float32 [H, W, C], linear radiance of R, G and B, W/(m² sr), and then the further
            channels of the integrator.
        samples_per_pixel: samples per pixel.
        noise: sum over all pixels of the standard errors of their radiance, averaged over R, G and
            B, relative to the sum of this radiance; None if there was one pass only.
        seconds: time of rendering, s.
    """

    channels: NDArray[np.float32]
    samples_per_pixel: int
    noise: float | None
    seconds: float

    @property
    def radiance(self) -> NDArray[np.float32]:
        """Linear radiance [H, W, 3], W/(m² sr)."""
        return self.channels[..., :3]


class _Mean:
    """Mean over passes, and its noise."""

    def __init__(self) -> None:
        self.samples, self.passes = 0, 0
        self._sum: Any = 0.0
        self._sum_of_grey: Any = 0.0
        self._sum_of_squares: Any = 0.0

    def add(self, image: NDArray[np.float32], samples: int) -> None:
        """Add a pass [H, W, C]."""
        grey = image[..., :3].mean(axis=-1, dtype=np.float64)
        self._sum = self._sum + samples * image
        self._sum_of_grey = self._sum_of_grey + samples * grey
        self._sum_of_squares = self._sum_of_squares + samples * grey**2
        self.samples, self.passes = self.samples + samples, self.passes + 1

    def image(self) -> NDArray[np.float32]:
        return (self._sum / self.samples).astype(np.float32)

    def noise(self) -> float | None:
        """As `Rendering.noise`.

        The variance of one sample is Σ_k n_k (x_k - x)² / (K - 1), and that of the mean the N-th
        part of it.
        """
        if self.passes < 2:
            return None
        mean = self._sum_of_grey / self.samples
        squares = np.maximum(self._sum_of_squares - self.samples * mean**2, 0)
        error = np.sqrt(squares / (self.passes - 1) / self.samples)
        return float(error.sum() / mean.sum()) if mean.any() else 0.0


def render_passes(
    scene: mi.Scene,
    integrator: mi.Integrator,
    budget: Budget,
    *,
    seed: int = 0,
    name: str = "render",
    so_far: Callable[[Rendering], None] | None = None,
) -> Rendering:
    """Render the scene's first sensor until a budget is spent.

    Equal seeds and numbers of samples give equal images if the budget is a number of samples. With
    others the number depends on how fast the machine is.

    Args:
        scene, integrator: what is rendered, and how.
        budget: when it ends.
        seed: root seed.
        name: for the display of progress.
        so_far: called with the image so far after the first pass and then every two seconds or
            more, so that it takes no more than a tenth of the time.
    """
    sensor = scene.sensors()[0]
    pixels = int(dr.prod(sensor.film().crop_size()))
    limit = budget.samples_per_pixel or MAX_SAMPLES
    batch = _SAMPLES_PER_PASS[dr.backend_v(mi.Float)] // pixels
    if (budget.seconds, budget.noise) != (None, None):
        batch = min(batch, _MAX_SAMPLES_PER_PIXEL, limit // _MIN_PASSES)
    batch = max(1, batch)
    mean, start = _Mean(), time.perf_counter()
    spent, seconds, noise, ended = 0.0, 0.0, None, False
    next_time = 0.0
    with progress(name, 1.0) as advance:
        while not ended:
            count = min(batch, limit - mean.samples)
            began = time.perf_counter()
            image = mi.render(
                scene,
                sensor=sensor,
                integrator=integrator,
                spp=count,
                seed=SeedStream(Purpose.RENDER, mean.samples).seed(seed),
            )
            mean.add(np.array(image), count)
            now = time.perf_counter()
            seconds, noise = now - start, mean.noise()
            share = budget.share(
                mean.samples, seconds, noise if mean.passes >= _MIN_PASSES else None
            )
            # A pass that would not end in time is not begun.
            late = budget.seconds is not None and seconds + (now - began) > budget.seconds
            ended = late or share >= 1
            advance(max(0.0, share - spent), "" if noise is None else f"noise {noise:.1%}")
            spent = max(spent, share)
            if so_far is not None and not ended and now >= next_time:
                so_far(Rendering(mean.image(), mean.samples, noise, seconds))
                taken = time.perf_counter() - now
                next_time = now + max(_SECONDS_BETWEEN_IMAGES, taken / _MOST_TIME_OF_IMAGES)
    return Rendering(mean.image(), mean.samples, noise, seconds)
