"""Independent batches of rays, and standard errors of figures computed from them (jackknife)."""

from collections.abc import Callable, Iterator
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import NDArray

from lumitree.core.seeds import SeedStream

if TYPE_CHECKING:
    from lumitree.trace.light_paths import EmittedRays, RayBatch

# Independent batches whose spread is the noise of an estimate.
BATCHES = 16


class RayBatches:
    """Rays in `BATCHES` batches of equal size, drawn in pieces.

    Iteration gives the batch of each piece, and its rays. The flux of the rays of each piece is an
    estimate of the whole flux.

    Args:
        num_rays: number of samples, rounded up to equal pieces.
        stream: random numbers of a piece, by its batch and its index in the batch.
        pieces: pieces of each batch, which bound the memory of large ones.

    Attributes:
        count: number of pieces; piece i belongs to batch i modulo `BATCHES`.
        size: number of samples of each.
    """

    def __init__(
        self,
        rays: "EmittedRays",
        num_rays: int,
        stream: Callable[[int, int], SeedStream],
        seed: int,
        *,
        pieces: int = 1,
    ) -> None:
        self._rays, self._stream, self._seed = rays, stream, seed
        self.count = BATCHES * pieces
        self.size = -(-num_rays // self.count)

    def __iter__(self) -> Iterator[tuple[int, "RayBatch"]]:
        for index in range(self.count):
            yield index % BATCHES, self._rays.draw(self.size, self.seed(index))

    def seed(self, index: int) -> int:
        """Seed of the draw of a piece."""
        return self._stream(index % BATCHES, index // BATCHES).seed(self._seed)


def jackknife(
    figure: Callable[[NDArray[np.bool_]], NDArray[np.float64] | float], batches: int = BATCHES
) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
    """Values of a figure for all batches, and their standard errors.

    `figure` takes a mask [B] of the batches to use.
    """
    value = np.asarray(figure(np.ones(batches, bool)), np.float64)
    without = [figure(np.arange(batches) != each) for each in range(batches)]
    return value, jackknife_error(np.array(without))


def jackknife_error(without: NDArray[np.floating]) -> NDArray[np.float64]:
    """Standard errors of figures from their values [B, ..] without each of B batches."""
    count, deviation = len(without), without - without.mean(axis=0)
    return np.sqrt((count - 1) / count * (deviation**2).sum(axis=0))
