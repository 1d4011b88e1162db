"""Images in passes: of bounded memory, with an estimate of their noise, until a budget is spent.

Symbols
    x_k, n_k    mean radiance of a pixel in pass k, samples per pixel of the pass
    N, K        samples per pixel of all passes, number of passes
"""

from __future__ import annotations

import contextlib
import dataclasses
import time
import warnings
from collections import deque
from collections.abc import Callable, Iterable, Iterator
from contextlib import AbstractContextManager

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import MAX_SAMPLES
from lumitree.core.checkpoint import Arrays, Checkpoint
from lumitree.core.images import block_means
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError, LumitreeWarning

# Samples a pass, by the backend of Dr.Jit: some seconds of work at most. Progress is shown, and
# Ctrl-C heeded, between passes; a GPU is idle while a pass is prepared.
_SAMPLES_PER_PASS = {
    dr.JitBackend.LLVM: 1 << 19,
    dr.JitBackend.CUDA: 1 << 23,
    dr.JitBackend.Metal: 1 << 23,
}
# Passes after which noise is known well enough to stop.
_MIN_PASSES = 8
# Least time between two images that are shown while they are rendered, s, and the largest part of
# the time that showing them takes.
_SECONDS_BETWEEN_IMAGES, _MOST_TIME_OF_IMAGES = 2.0, 0.1
# Time of rendering after which an unfinished image is saved at the end, s.
_WORTH_SAVING = 30.0
# Width and height of the blocks of pixels over which noise is averaged.
_BLOCK = 16
# Samples per pixel of a pass at most, where it is not known how many there will be.
_MAX_SAMPLES_PER_PIXEL = 16


@dataclasses.dataclass(frozen=True)
class Budget:
    """When a render stops: at the first limit that is reached.

    Attributes:
        spp: number of samples, or None.
        seconds: time of rendering, s, or None. One pass is always completed.
        noise: relative noise as `Rendering.noise`, or None. Eight passes are always completed.
    """

    spp: int | None = None
    seconds: float | None = None
    noise: float | None = None

    def __post_init__(self) -> None:
        if self.spp is not None and self.spp < 1:
            raise LumitreeError(f"spp is {self.spp}; expected at least 1")

    def share(self, samples: int, seconds: float, noise: float | None) -> float:
        """Part of the budget that is spent, 0 to 1."""
        shares = [samples / (self.spp or MAX_SAMPLES)]
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
        channels: float32 [H, W, C], linear radiance of R, G and B, W/(m² sr), then alpha if the
            film has it, and then the further channels of the integrator.
        spp: samples per pixel.
        noise: relative standard error of the radiance of a pixel, averaged over R, G and B: the
            root mean square in each block of 16 x 16 pixels, relative to the block's mean radiance;
            averaged over the blocks, of which those darker than the median of the blocks with light
            weigh in proportion to their radiance. None if there was one pass only.
        seconds: time of rendering, s.
    """

    channels: NDArray[np.float32]
    spp: int
    noise: float | None
    seconds: float

    @property
    def radiance(self) -> NDArray[np.float32]:
        """Linear radiance [H, W, 3], W/(m² sr)."""
        return self.channels[..., :3]


@dataclasses.dataclass(frozen=True)
class PassSums:
    """Sums over the passes of an image.

    Attributes:
        radiance: float32 [H, W, C], of samples per pixel times channels of the image.
        grey, squares: float64 [H, W], of samples per pixel times the mean of R, G and B of a pass,
            and times its square.
        samples, passes: samples per pixel, and number of passes.
        seconds: time of rendering, s.
    """

    radiance: NDArray[np.float32]
    grey: NDArray[np.float64]
    squares: NDArray[np.float64]
    samples: int
    passes: int
    seconds: float

    def arrays(self) -> Arrays:
        """The same as arrays, for a checkpoint."""
        return {name: np.asarray(value) for name, value in vars(self).items()}

    @staticmethod
    def load(checkpoint: Checkpoint, batch: int, limit: int) -> PassSums | None:
        """The sums of a checkpoint; None if there is none.

        Warns, and returns None, if it belongs to another image or to other passes, or is damaged.
        """
        try:
            if (arrays := checkpoint.load()) is None:
                return None
            numbers = {name: arrays.pop(name).item() for name in ("samples", "passes", "seconds")}
            sums = PassSums(**arrays, **numbers)
            # Else the passes to come would have other seeds than in an image without interruption.
            if sums.samples % batch and sums.samples != limit:
                raise LumitreeError("its last pass has fewer samples than the others")
            if sums.samples > limit:
                raise LumitreeError(f"it has {sums.samples} samples per pixel, more than {limit}")
        except (LumitreeError, KeyError, TypeError) as error:
            warnings.warn(
                f"an unfinished image is not continued: {error}; it starts again",
                LumitreeWarning,
                stacklevel=2,
            )
            return None
        return sums


def _with_pass(sums: PassSums | None, image: NDArray[np.float32], samples: int) -> PassSums:
    """The sums with another pass [H, W, C]."""
    grey = image[..., :3].mean(axis=-1, dtype=np.float64)
    radiance: NDArray[np.float32] = (samples * image).astype(np.float32, copy=False)
    squares = samples * grey**2
    if sums is None:
        return PassSums(radiance, samples * grey, squares, samples, 1, 0.0)
    return PassSums(
        np.add(sums.radiance, radiance, dtype=np.float32),
        sums.grey + samples * grey,
        sums.squares + squares,
        sums.samples + samples,
        sums.passes + 1,
        sums.seconds,
    )


def _rendering(sums: PassSums) -> Rendering:
    """The mean of passes."""
    image = (sums.radiance / sums.samples).astype(np.float32, copy=False)
    return Rendering(image, sums.samples, _noise(sums), sums.seconds)


def _noise(sums: PassSums) -> float | None:
    """As `Rendering.noise`.

    The variance of one sample is Σ_k n_k (x_k - x)² / (K - 1), and the variance of the mean its
    N-th part. Where light is found by rare samples only, most pixels have neither light nor
    variance yet: only the mean over many of them is known.
    """
    if sums.passes < 2:
        return None
    mean = sums.grey / sums.samples
    with np.errstate(invalid="ignore"):
        squares = np.maximum(sums.squares - sums.samples * mean**2, 0)
    known = np.isfinite(mean) & np.isfinite(squares)
    if not known.any():
        return None
    # Share of the pixels of a block that are numbers.
    share = np.maximum(block_means(known.astype(np.float64), _BLOCK), 1e-300)
    variance = np.where(known, squares, 0) / (sums.passes - 1) / sums.samples
    variance, level = (
        block_means(each, _BLOCK) / share for each in (variance, np.where(known, mean, 0))
    )
    lit = level > 0
    if not lit.any():
        return 0.0
    error, level = np.sqrt(variance[lit]), level[lit]
    # Neither the lamp itself nor nearly black blocks decide.
    weights = 1 / np.maximum(level, np.median(level))
    return float((weights * error).sum() / (weights * level).sum())


# Renders passes, given as seed and samples per pixel, and returns their images in the same order.
# It may read some passes ahead.
Renderer = Callable[
    [Iterable[tuple[int, int]]], AbstractContextManager[Iterator[NDArray[np.float32]]]
]


def render_pass(
    scene: mi.Scene, integrator: mi.Integrator, seed: int, samples: int
) -> NDArray[np.float32]:
    """Image [H, W, C] of one pass of the scene's first sensor; channels as `Rendering.channels`."""
    sensor = scene.sensors()[0]
    return np.array(mi.render(scene, sensor=sensor, integrator=integrator, spp=samples, seed=seed))


def render_passes(
    scene: mi.Scene,
    integrator: mi.Integrator,
    budget: Budget,
    *,
    seed: int = 0,
    name: str = "render",
    so_far: Callable[[Rendering], None] | None = None,
    renderer: Renderer | None = None,
    checkpoint: Checkpoint | None = None,
) -> Rendering:
    """Render the scene's first sensor until a budget is spent.

    Equal seeds and numbers of samples give images that agree within rounding. With a budget
    that is not a number of samples, the number depends on how fast the machine is.

    Args:
        so_far: called with the image so far after the first pass and then every two seconds or
            more, so that it takes no more than a tenth of the time.
        renderer: function that renders the passes. Default: `render_pass`, one after another.
        checkpoint: of the passes so far, from which an interrupted call continues.
    """
    pixels = int(dr.prod(scene.sensors()[0].film().crop_size()))
    plan = _Plan(budget, pixels, seed)
    sums = None if checkpoint is None else PassSums.load(checkpoint, plan.batch, plan.limit)
    spent = 0.0
    if sums is not None:
        spent = _share(budget, sums, _noise(sums))
        plan.continue_after(sums.samples, sums.seconds, is_over=spent >= 1)
        name += f", continued after {sums.samples:,} samples per pixel"
    next_time = 0.0
    if renderer is None:
        here = (render_pass(scene, integrator, *each) for each in plan)
        images = contextlib.nullcontext(here)
    else:
        images = renderer(plan)
    with progress(name, 1.0) as advance, images as rendered, _kept(checkpoint, lambda: sums):
        advance(spent)
        for image in rendered:
            added = _with_pass(sums, image, plan.next_samples)
            now = plan.finish()
            sums = dataclasses.replace(added, seconds=plan.seconds)
            noise = _noise(sums)
            share = _share(budget, sums, noise)
            # The display counts the noise of few passes as the share of them, and does not show it.
            guess = budget.share(sums.samples, sums.seconds, noise)
            done = max(spent, share, min(guess, sums.passes / _MIN_PASSES))
            note = (
                "" if noise is None or sums.passes < _MIN_PASSES else f"noise {100 * noise:.1f} %"
            )
            advance(done - spent, note)
            spent = done
            if plan.is_over or share >= 1:
                break
            if checkpoint is not None:
                checkpoint.offer(sums.arrays)
            if so_far is not None and now >= next_time:
                so_far(_rendering(sums))
                taken = time.perf_counter() - now
                next_time = now + max(_SECONDS_BETWEEN_IMAGES, taken / _MOST_TIME_OF_IMAGES)
    assert sums is not None
    return _rendering(sums)


def _share(budget: Budget, sums: PassSums, noise: float | None) -> float:
    """As `Budget.share`; the noise of few passes is not known well enough."""
    known = noise if sums.passes >= _MIN_PASSES else None
    return budget.share(sums.samples, sums.seconds, known)


@contextlib.contextmanager
def _kept(checkpoint: Checkpoint | None, sums: Callable[[], PassSums | None]) -> Iterator[None]:
    """Context at whose end sums of some time are saved, also if a signal or an error ends it."""
    try:
        yield
    finally:
        found = sums()
        if checkpoint and found and found.seconds >= _WORTH_SAVING:
            checkpoint.try_save(found.arrays())


class _Plan:
    """The passes of a budget: (seed, samples per pixel) of each in turn.

    Attributes:
        batch: samples per pixel of each pass but the last.
        limit: samples per pixel of all passes at most.
        seconds: time until the latest pass was finished, s.
        is_over: whether the next pass would not end in time, and none has begun.
    """

    def __init__(self, budget: Budget, pixels: int, seed: int) -> None:
        self._seed, self._time = seed, budget.seconds
        self.limit = budget.spp or MAX_SAMPLES
        batch = _SAMPLES_PER_PASS[dr.backend_v(mi.Float)] // pixels
        if (budget.seconds, budget.noise) != (None, None):
            batch = min(batch, _MAX_SAMPLES_PER_PIXEL, self.limit // _MIN_PASSES)
        self.batch = max(1, batch)
        self._start, self.seconds, self.is_over = time.perf_counter(), 0.0, False
        # Samples per pixel of the passes that are not finished, and when they began.
        self._begun: deque[tuple[int, float]] = deque()
        self._first = 0

    def continue_after(self, samples: int, seconds: float, *, is_over: bool) -> None:
        """Begin after the passes of an earlier call, which took `seconds`."""
        self._first, self.is_over = samples, is_over
        self._start -= seconds

    def __iter__(self) -> Iterator[tuple[int, int]]:
        samples = self._first
        while samples < self.limit and not self.is_over:
            count = min(self.batch, self.limit - samples)
            self._begun.append((count, time.perf_counter()))
            yield SeedStream(Purpose.RENDER, samples).seed(self._seed), count
            samples += count

    @property
    def next_samples(self) -> int:
        """Samples per pixel of the pass that is finished next."""
        return self._begun[0][0]

    def finish(self) -> float:
        """Count the pass that was begun first as finished; returns the time of the clock, s."""
        now = time.perf_counter()
        _, began = self._begun.popleft()
        self.seconds = now - self._start
        # How long a pass takes is not known where others have begun before it ended.
        if self._time is not None and not self._begun:
            self.is_over = self.seconds + (now - began) > self._time
        return now
