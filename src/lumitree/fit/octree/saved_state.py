"""The saved state of an unfinished bake, from which the same bake continues."""

import dataclasses
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.files import WriteError, atomic_path
from lumitree.core.reading import read_arrays
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.fit.octree.config import OctreeFitConfig
from lumitree.fit.octree.leaf_field import LEAVES, LeafField
from lumitree.fit.octree.ray_source import Subject
from lumitree.fit.octree.refine import Refiner

STATE = "state.npz"
# Raised whenever the arrays of a state or their meaning change.
_VERSION = 2


@dataclasses.dataclass(frozen=True)
class SavedState:
    """What a folder holds of a bake.

    Attributes:
        seconds, rays: spent so far.
        max_radiance: L_max of the field.
    """

    seconds: float
    rays: int
    max_radiance: float
    _arrays: dict[str, NDArray[Any]]

    def restore(self, refiner: Refiner) -> LeafField:
        """Give a refiner its field and optimiser back; returns the best field so far."""
        refiner.restore(self._arrays)
        return refiner.field.with_leaves(*(self._arrays[f"best_{name}"] for name in LEAVES))


class StateFile:
    """The file in which the state of one bake is kept.

    Args:
        folder: the folder of the file.
        subject: what is baked.
        config: how. A state is only continued with an equal one, except that the budget may be
            another.
    """

    def __init__(self, folder: Path, subject: Subject, config: OctreeFitConfig) -> None:
        settings = dataclasses.asdict(config)
        del settings["time"], settings["rays"]
        record = {"version": _VERSION, "fingerprint": subject.fingerprint, **settings}
        self._path, self._record = folder / STATE, json.dumps(record, sort_keys=True)
        self._warned = False

    def load(self) -> SavedState | None:
        """The state, or None if there is none.

        Raises:
            LumitreeError: the file is damaged, or holds the state of another bake.
        """
        if not self._path.exists():
            return None
        try:
            arrays = dict(read_arrays(self._path))
            found = str(arrays["record"])
        except (LumitreeError, KeyError) as error:
            no_state = f"{self._path} is no state of a bake"
            reason = str(error) if isinstance(error, LumitreeError) else no_state
            raise LumitreeError(f"{reason}; remove its folder to start again") from None
        if found != self._record:
            raise LumitreeError(
                f"{self._path.parent} holds the unfinished bake of another luminaire, with other "
                "settings or by another version of lumitree; remove it, or choose another output "
                "with -o"
            )
        return SavedState(
            float(arrays["seconds"]), int(arrays["rays"]), float(arrays["max_radiance"]), arrays
        )

    def save(
        self, refiner: Refiner, best: LeafField, seconds: float, rays: int, max_radiance: float
    ) -> None:
        """Save the state; warns, once, where that fails: the bake itself can go on."""
        state = refiner.state()
        state["max_radiance"] = np.array(max_radiance)
        state["seconds"] = np.array(seconds)
        state["rays"] = np.array(rays)
        state["record"] = np.array(self._record)
        state |= {f"best_{name}": value for name, value in best.arrays().items()}
        try:
            with atomic_path(self._path) as temporary:
                np.savez(temporary, **state)  # type: ignore[arg-type]
            self._warned = False
        except WriteError as error:
            if not self._warned:
                self._warned = True
                warnings.warn(
                    f"cannot save the state of the bake in {self._path.parent}: {error.reason}; "
                    "the bake goes on, but cannot be continued if it is killed",
                    LumitreeWarning,
                    stacklevel=2,
                )
