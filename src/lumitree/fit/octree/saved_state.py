"""The saved state of an unfinished bake, from which the same bake continues."""

import dataclasses
import json
import warnings
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.files import WriteError, atomic_path
from lumitree.core.harmonics import num_coefficients
from lumitree.core.reading import expect, expect_arrays, read_arrays
from lumitree.errors import LumitreeError, LumitreeWarning
from lumitree.fit.octree.config import OctreeConfig
from lumitree.fit.octree.leaf_field import LeafField, padded_width
from lumitree.fit.octree.rays import Subject

STATE = "state.npz"
# Raised whenever the arrays of a state or their meaning change.
_VERSION = 2


class OtherBakeError(LumitreeError):
    """A folder holds the state of another bake."""


@dataclasses.dataclass(frozen=True)
class SavedState:
    """Saved state of a bake, with the time and rays spent so far."""

    seconds: float
    rays: int
    max_radiance: float
    arrays: dict[str, NDArray[Any]]


class StateFile:
    """The file in which the state of one bake is kept.

    A state is only continued with equal settings, except that the budget may differ.
    """

    def __init__(self, folder: Path, subject: Subject, config: OctreeConfig, seed: int = 0) -> None:
        settings = dataclasses.asdict(config) | {"seed": seed}
        del settings["time"], settings["rays"]
        record = {"version": _VERSION, "fingerprint": subject.fingerprint, **settings}
        self._path, self._record = folder / STATE, json.dumps(record, sort_keys=True)
        self._config = config
        self._warned = False

    def load(self) -> SavedState | None:
        """The state, or None if there is none.

        Raises:
            OtherBakeError: the file holds the state of another bake.
            LumitreeError: it is damaged.
        """
        if not self._path.exists():
            return None
        again = "remove its folder to start again"
        try:
            arrays = read_arrays(self._path)
        except LumitreeError as error:
            raise LumitreeError(f"{error}; {again}") from None
        if "record" not in arrays:
            raise LumitreeError(f"{self._path} is no state of a bake; {again}")
        if str(arrays["record"]) != self._record:
            raise OtherBakeError(
                f"{self._path.parent} holds the unfinished bake of another luminaire, with other "
                "settings or by another version of lumitree; remove it, or choose another output "
                "with -o"
            )
        try:
            _check(arrays, self._config)
        except LumitreeError as error:
            raise LumitreeError(f"{self._path} is damaged ({error}); {again}") from None
        return SavedState(
            float(arrays["seconds"]), int(arrays["rays"]), float(arrays["max_radiance"]), arrays
        )

    def save(
        self,
        state: dict[str, NDArray[Any]],
        best: LeafField,
        seconds: float,
        rays: int,
        max_radiance: float,
    ) -> None:
        """Save the state; warns, once, where that fails: the bake itself can go on."""
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


def _check(arrays: dict[str, NDArray[Any]], config: OctreeConfig) -> None:
    """Refuse arrays that are missing, or have a wrong type, shape or range."""
    terms = num_coefficients(config.l_max)
    leaves, best = (arrays.get(name, np.zeros(0)).shape[:1] for name in ("levels", "best_levels"))
    padded = tuple(count * padded_width(config.l_max) for count in leaves)
    expected: dict[str, tuple[type[np.generic], tuple[int, ...]]] = {
        **dict.fromkeys(("seconds", "max_radiance"), (np.float64, ())),
        **{"rays": (np.int64, ()), "steps": (np.int64, (2,))},
        **dict.fromkeys(("density_mean", "density_square"), (np.float32, leaves)),
        **dict.fromkeys(("coefficient_mean", "coefficient_square"), (np.float32, padded)),
    }
    for prefix, count in (("", leaves), ("best_", best)):
        expected |= {
            f"{prefix}cells": (np.int64, (*count, 3)),
            f"{prefix}levels": (np.int64, count),
            f"{prefix}log_density": (np.float32, count),
            f"{prefix}coefficients": (np.float32, (*count, 3, terms)),
        }
    for name in expected:
        expect("state", name in arrays, f"{name} is missing")
    expect_arrays("state", {name: (arrays[name], *kind) for name, kind in expected.items()})
    for prefix in ("", "best_"):
        cells, levels = arrays[f"{prefix}cells"], arrays[f"{prefix}levels"]
        fits = ((levels >= 1) & (levels <= config.tree_depth)).all()
        fits = fits and ((cells >= 0) & (cells < 1 << levels[:, None])).all()
        expect("state", fits, "a leaf is outside the tree")
    numbers = (arrays[name] for name in expected)
    expect("state", all(np.isfinite(each).all() for each in numbers), "a number is not finite")
    counts = (arrays[name] >= 0 for name in ("seconds", "rays", "steps"))
    sound = all(each.all() for each in counts) and arrays["max_radiance"] > 0
    expect("state", sound, "a number is out of range")
