"""Training by Adam on random batches of rays; a resumed run gives the same bits.

The folder of a run has one file, `run.npz`: a `core.checkpoint` with the weights of the networks,
Adam's moments, the occupancy grid, and the history of the loss. Its fingerprint is a `RunRecord`.
"""

import contextlib
import dataclasses
import functools
import os
import time
from pathlib import Path

import jax
import jax.numpy as jnp
import numpy as np

from lumitree.core.checkpoint import Arrays, Checkpoint, read_checkpoint
from lumitree.core.files import WriteError, exclusive, is_empty
from lumitree.core.frames import LocalFrame, file_members, with_frame
from lumitree.core.interruption import deferred_interrupt
from lumitree.core.progress import progress
from lumitree.core.reading import label
from lumitree.core.seeds import check_seed
from lumitree.core.tables import converted
from lumitree.errors import LumitreeError
from lumitree.fit.network.config import TrainConfig
from lumitree.fit.network.rays import Occupancy, RaySet, load_rays
from lumitree.fit.network.step import (
    TrainState,
    initial_state,
    make_evaluation,
    make_step,
    psnr,
    state_sharding,
)
from lumitree.lamp.dataset import Dataset

RUN = "run.npz"
_REPORT_SECONDS = 5.0
# Losses are read back in groups, so that a GPU does not wait for the host.
_STEPS_PER_CHECK = 10


@dataclasses.dataclass(frozen=True)
class RunRecord:
    """Inputs of a run: what its result depends on, and what extraction needs beside the weights.

    Attributes:
        config: settings.
        seed: of the initial weights, the batches and the jitter.
        fingerprint: of the luminaire that the views show.
        luminaire: its name.
        max_radiance: L_max.
        frame: local frame.
    """

    config: TrainConfig
    seed: int
    fingerprint: str
    luminaire: str
    max_radiance: float
    frame: LocalFrame

    def __post_init__(self) -> None:
        object.__setattr__(self, "luminaire", label(self.luminaire))
        check_seed(self.seed)
        if not 0 < self.max_radiance < float("inf"):
            raise LumitreeError(f"max_radiance is {self.max_radiance}; expected a positive number")


@dataclasses.dataclass(frozen=True)
class Run:
    """The state of a run that was saved."""

    record: RunRecord
    state: TrainState
    occupancy: Occupancy


def load_run(folder: Path) -> Run:
    """The run of a folder.

    Raises:
        LumitreeError: there is none, or its file is damaged.
    """
    path = folder / RUN
    if not path.exists():
        raise LumitreeError(f"{folder} has no {RUN}; expected a run made by 'lumitree train'")
    members, arrays = read_checkpoint(path)
    try:
        members.pop("lumitree", None)
        record = converted(with_frame(members, "frame"), RunRecord)
        _, template = initial_state(record.config, initial_emission=0.5)
        return Run(record, _state(arrays, template), Occupancy.of_arrays(arrays))
    except (LumitreeError, KeyError) as error:
        raise LumitreeError(f"{path} is damaged ({error}); train again") from None


def _state(arrays: Arrays, template: TrainState) -> TrainState:
    """The state of a checkpoint, whose arrays must have the shapes and types of a template."""
    leaves, structure = jax.tree.flatten(template)
    found = [arrays[f"state{index}"] for index in range(len(leaves))]
    for leaf, array in zip(leaves, found, strict=True):
        if (array.shape, array.dtype) != (leaf.shape, leaf.dtype):
            raise LumitreeError(f"an array is {array.dtype} {array.shape}")
    return jax.tree.unflatten(structure, map(jnp.asarray, found))


@dataclasses.dataclass(frozen=True)
class TrainResult:
    """Result of a call of `train`.

    Attributes:
        steps: steps done by this call and earlier ones.
        seconds: time of these steps, without the time to read the dataset.
        psnr: PSNR of the held-out rays, dB (`losses.psnr`).
        psnr_black: PSNR of an all-black prediction of the same rays, dB.
        rays_per_second: training speed of this call.
        stopped_by: number of the signal that ended the call early; None if none did.
    """

    steps: int
    seconds: float
    psnr: float
    psnr_black: float
    rays_per_second: float
    stopped_by: int | None


def train(
    dataset_path: str | os.PathLike[str],
    run_path: str | os.PathLike[str],
    config: TrainConfig,
    seed: int = 0,
    resume: bool = False,
    stop_after: int | None = None,
) -> TrainResult:
    """Train a NeRF-SH on a dataset (Sec. 4.4), or continue a run.

    Args:
        dataset_path: folder made by `lumitree capture`.
        run_path: folder of the run: missing or empty, or with `resume` the folder of any run.
        config: settings; with `resume` they must equal the settings of the run.
        seed: seed of the initial weights, the batches and the jitter; with `resume` the same.
        resume: continue from the checkpoint, if there is one. The result equals the result of an
            uninterrupted run.
        stop_after: stop and save after this number of steps.

    Raises:
        LumitreeError: the dataset or the folder cannot be used, another process works in the
            folder, the settings or the views differ from the run's, there is nothing to resume, or
            the loss is not finite.
    """
    dataset, folder = Dataset.open(dataset_path), Path(run_path)
    made = not folder.exists()
    _check_folder(folder, resume)
    rays, occupancy = load_rays(dataset, config.opacity_kind, config.skip_empty)
    manifest = dataset.manifest
    record = RunRecord(
        config,
        seed,
        manifest.fingerprint,
        manifest.luminaire,
        rays.max_radiance,
        manifest.local_frame,
    )
    with exclusive(folder):
        # Again, since another process may have worked in the folder meanwhile.
        _check_folder(folder, resume)
        loop = _Loop(folder, rays, occupancy, record)
        try:
            return loop.run(stop_after)
        except WriteError:
            if made:
                with contextlib.suppress(OSError):
                    folder.rmdir()
            raise


def _check_folder(folder: Path, resume: bool) -> None:
    """Refuse, before any work, a folder that cannot be used."""
    if not folder.exists() and resume:
        raise LumitreeError(f"{folder} does not exist: nothing to resume")
    if folder.exists() and not folder.is_dir():
        raise LumitreeError(f"{folder} is not a folder; choose another output with -o")
    if not folder.exists() or is_empty(folder):
        return
    if not resume:
        raise LumitreeError(
            f"{folder} is not empty; continue it with --resume or choose another output with -o"
        )
    if not (folder / RUN).exists():
        raise LumitreeError(f"{folder} has no {RUN}: nothing to resume")


class _Loop:
    """The steps of one call, with reports and checkpoints at their intervals.

    It continues from the checkpoint of the folder, if there is one.
    """

    def __init__(self, folder: Path, rays: RaySet, occupancy: Occupancy, record: RunRecord) -> None:
        config = record.config
        self.folder, self.rays, self.config, self.seed = folder, rays, config, record.seed
        self.checkpoint = Checkpoint(folder / RUN, file_members(record), "training")
        graph, self.state = initial_state(config, rays.typical_part, record.seed)
        # Rows of step, seconds, loss and PSNR.
        self.history: list[tuple[float, float, float, float]] = []
        self.saved_step: int | None = None
        if (arrays := self.checkpoint.load()) is not None:
            self.state = _state(arrays, self.state)
            self.history = list(map(tuple, arrays["history"].tolist()))
            self.saved_step = int(self.state.step)
        self.occupancy_arrays = occupancy.arrays()
        self.held_out = rays.held_out()
        self.occupancy = jax.device_put(occupancy, state_sharding(config))
        self.step = make_step(config, graph, rays.max_radiance, record.seed)
        self.evaluate = make_evaluation(config, graph, rays.max_radiance)
        self.earlier = self.history[-1][1] if self.history else 0.0
        self.seconds = self.earlier
        self.pending: list[tuple[jax.Array, jax.Array]] = []

    def run(self, stop_after: int | None) -> TrainResult:
        """Train and save the state, unless the loss is not finite."""
        state = jax.device_put(self.state, state_sharding(self.config))
        first = done = int(state.step)
        last = self.config.num_steps
        if stop_after is not None:
            last = min(last, done + stop_after)
        start = reported = time.monotonic()
        with (
            deferred_interrupt() as interrupted,
            progress("train", self.config.num_steps, done) as advance,
        ):
            note = ""
            while done < last and not interrupted:
                batch = self.rays.draw(self.seed, done, self.config.rays_per_batch)
                state, loss, norm = self.step(state, batch, self.occupancy)
                self.pending.append((loss, norm))
                done += 1
                if len(self.pending) >= _STEPS_PER_CHECK or done == last:
                    shown = self._check(done)
                    now = time.monotonic()
                    self.seconds = self.earlier + now - start
                    if now - reported >= _REPORT_SECONDS or done == last:
                        reported = now
                        speed = (done - first) * self.config.rays_per_batch / (now - start)
                        note = self._report(done, shown, state, speed)
                    self.checkpoint.offer(functools.partial(self._arrays, state))
                advance(1, note)
            self._check(done)
            self.seconds = self.earlier + time.monotonic() - start
            if self.saved_step != done:
                self.checkpoint.save(self._arrays(state))
                self.saved_step = done
        rate = (done - first) * self.config.rays_per_batch / max(self.seconds - self.earlier, 1e-9)
        black = psnr(jnp.zeros(3), self.held_out.radiance, self.rays.max_radiance)
        quality = float(self.evaluate(state.params, self.held_out, self.occupancy))
        return TrainResult(done, self.seconds, quality, float(black), rate, interrupted.number)

    def _check(self, done: int) -> float:
        """The last loss; refuses losses since the last check that are not finite."""
        values = np.array(jax.device_get(self.pending), np.float64).reshape(-1, 2)
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            step = done - len(values) + int(bad[0]) + 1
            kept = " (the checkpoint there is good)" if self.checkpoint.exists else ""
            raise LumitreeError(
                f"the loss is not finite at step {step}; lower learning_rate_start, and train in "
                f"another folder than {self.folder}{kept}"
            )
        self.pending.clear()
        return float(values[-1, 0]) if len(values) else float("nan")

    def _report(self, done: int, loss: float, state: TrainState, rate: float) -> str:
        quality = float(self.evaluate(state.params, self.held_out, self.occupancy))
        self.history.append((done, round(self.seconds, 3), loss, quality))
        return f"loss {loss:.3g}, PSNR {quality:.2f} dB, {rate / 1000:.1f} k rays/s"

    def _arrays(self, state: TrainState) -> Arrays:
        leaves = jax.device_get(jax.tree.leaves(state))
        weights: Arrays = {f"state{index}": np.asarray(leaf) for index, leaf in enumerate(leaves)}
        history = np.array(self.history, np.float64).reshape(-1, 4)
        return {**weights, **self.occupancy_arrays, "history": history}
