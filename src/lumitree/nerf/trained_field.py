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
from lumitree.core.transmittance import Law
from lumitree.nerf.occupancy import Occupancy, contains, load_occupancy
from lumitree.nerf.run import OCCUPANCY, RunRecord, restore_checkpoint
from lumitree.nerf.step import initial_state

# Positions per call of the network. 4096 fit a CPU's caches (and were measured to be three times
# faster than 8192); a GPU needs more to be busy.
_CPU_CHUNK, _GPU_CHUNK = 4096, 1 << 18


@dataclasses.dataclass(frozen=True)
class TrainedField:
    """The fine network of a run.

    Attributes:
        law: transmittance law.
        l_max: highest band.
        max_radiance: L_max; the emission is max_radiance * sigmoid(sum of coefficient * Y).
        frame: the luminaire's local frame.
        luminaire: name of the luminaire.
        num_steps: number of training steps.
        occupancy: cells that may be occupied; density is 0 outside of them.
    """

    law: Law
    l_max: int
    max_radiance: float
    frame: LocalFrame
    luminaire: str
    num_steps: int
    occupancy: Occupancy
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
        coefficients = np.zeros((len(positions), 3, num_coefficients(self.l_max)), np.float32)
        chunk = _CPU_CHUNK if jax.default_backend() == "cpu" else _GPU_CHUNK
        padded = np.zeros((chunk, 3), np.float32)  # so that each function is compiled once
        for start in range(0, len(positions), chunk):
            held = slice(start, min(start + chunk, len(positions)))
            count = held.stop - start
            padded[:count] = positions[held]
            inside = np.asarray(self._contains(padded))[:count]
            if inside.any():
                sigma, values = self._network(padded)
                density[held] = np.asarray(sigma)[:count] * inside
                coefficients[held] = np.asarray(values)[:count]
        return density, coefficients


def load_field(run_path: str | os.PathLike[str]) -> TrainedField:
    """The field of a run's newest checkpoint.

    Raises:
        LumitreeError: the folder is damaged, not a run, or has no checkpoint.
    """
    folder = Path(run_path)
    record = RunRecord.load(folder)
    occupancy = jax.device_put(load_occupancy(folder / OCCUPANCY))
    graph, template = initial_state(record.config, initial_emission=0.5)
    state = restore_checkpoint(folder, template)
    networks = nnx.merge(graph, state.params)
    return TrainedField(
        law=record.config.law,
        l_max=record.config.l_max,
        max_radiance=record.max_radiance,
        frame=record.frame,
        luminaire=record.luminaire,
        num_steps=int(state.step),
        occupancy=occupancy,
        _contains=jax.jit(lambda positions: contains(occupancy, positions)),
        _network=jax.jit(networks.fine.__call__),
    )
