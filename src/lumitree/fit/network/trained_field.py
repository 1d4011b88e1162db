"""A trained field, which returns density and coefficients at positions."""

import dataclasses
import os
from collections.abc import Callable
from pathlib import Path

import jax
import numpy as np
from flax import nnx
from numpy.typing import ArrayLike, NDArray

from lumitree.core.frames import LocalFrame
from lumitree.core.harmonics import num_coefficients
from lumitree.fit.network.config import TrainConfig
from lumitree.fit.network.network import render
from lumitree.fit.network.rays import Occupancy, contains
from lumitree.fit.network.step import initial_state
from lumitree.fit.network.train import load_run

# Positions per call of the network. 4096 fit a CPU's caches (and were measured to be three times
# faster than 8192); a GPU needs more to be busy.
_CPU_CHUNK, _GPU_CHUNK = 4096, 1 << 18


@dataclasses.dataclass(frozen=True)
class TrainedField:
    """The fine network of a run; the emission is max_radiance · sigmoid(sum of coefficient · Y).

    The density is 0 outside the cells of `occupancy`.
    """

    config: TrainConfig
    max_radiance: float
    frame: LocalFrame
    luminaire: str
    num_steps: int
    occupancy: Occupancy
    _rays_per_call: int
    _render: Callable[[NDArray[np.float32], NDArray[np.float32]], tuple[jax.Array, jax.Array]]
    _contains: Callable[[NDArray[np.float32]], jax.Array]
    _network: Callable[[NDArray[np.float32]], tuple[jax.Array, jax.Array]]

    def query(self, positions: ArrayLike) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Density and coefficients at positions.

        Args:
            positions: [N, 3] local units.

        Returns:
            Density [N] per local unit, >= 0, and coefficients [N, 3, (l_max + 1)²]. Density is 0
            outside of the box and of the occupied cells.
        """
        positions = np.asarray(positions, np.float32).reshape(-1, 3)
        density = np.zeros(len(positions), np.float32)
        coefficients = np.zeros(
            (len(positions), 3, num_coefficients(self.config.l_max)), np.float32
        )
        chunk = _CPU_CHUNK if jax.default_backend() == "cpu" else _GPU_CHUNK
        padded = np.zeros((chunk, 3), np.float32)  # so that each function is compiled once
        for start in range(0, len(positions), chunk):
            rows = slice(start, min(start + chunk, len(positions)))
            count = rows.stop - start
            padded[:count] = positions[rows]
            inside = np.asarray(self._contains(padded))[:count]
            if inside.any():
                sigma, values = self._network(padded)
                density[rows] = np.asarray(sigma)[:count] * inside
                coefficients[rows] = np.asarray(values)[:count]
        return density, coefficients

    def render(
        self, origins: ArrayLike, directions: ArrayLike
    ) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Radiance and opacity along rays by the networks themselves, as in training (Eq. 3 to 5).

        Args:
            origins: [N, 3] outside of the box, local units.
            directions: [N, 3] unit directions of travel, local frame.

        Returns:
            Radiance [N, 3], in the luminaire's unit, and opacity [N].
        """
        origins = np.asarray(origins, np.float32).reshape(-1, 3)
        directions = np.broadcast_to(np.asarray(directions, np.float32), origins.shape)
        radiance = np.zeros((len(origins), 3), np.float32)
        opacity = np.zeros(len(origins), np.float32)
        size = self._rays_per_call
        padded_origins, padded_directions = (np.zeros((size, 3), np.float32) for _ in range(2))
        padded_directions[:] = (0, 0, 1)
        for start in range(0, len(origins), size):
            rows = slice(start, min(start + size, len(origins)))
            count = rows.stop - start
            padded_origins[:count], padded_directions[:count] = origins[rows], directions[rows]
            colours, opacities = self._render(padded_origins, padded_directions)
            radiance[rows] = np.asarray(colours)[:count]
            opacity[rows] = np.asarray(opacities)[:count]
        return radiance, opacity


def load_field(run_path: str | os.PathLike[str]) -> TrainedField:
    """The field of a run's newest checkpoint.

    Raises:
        LumitreeError: the folder is damaged, not a run, or has no checkpoint.
    """
    run = load_run(Path(run_path))
    record, state, occupancy = run.record, run.state, jax.device_put(run.occupancy)
    graph, _ = initial_state(record.config, initial_emission=0.5)
    networks, config = nnx.merge(graph, state.params), record.config

    def rendered(origins: jax.Array, directions: jax.Array) -> tuple[jax.Array, jax.Array]:
        highest = record.max_radiance
        _, fine = render(networks, occupancy, origins, directions, highest, config, None)
        return fine.radiance, fine.opacity

    chunk = _CPU_CHUNK if jax.default_backend() == "cpu" else _GPU_CHUNK
    positions = 2 * config.num_coarse + config.num_fine
    return TrainedField(
        config=config,
        max_radiance=record.max_radiance,
        frame=record.frame,
        luminaire=record.luminaire,
        num_steps=int(state.step),
        occupancy=occupancy,
        _rays_per_call=max(1, chunk // positions),
        _render=jax.jit(rendered),
        _contains=jax.jit(lambda positions: contains(occupancy, positions)),
        _network=jax.jit(networks.fine.__call__),
    )
