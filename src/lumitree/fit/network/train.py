"""Training by Adam on random batches of rays; a resumed run gives the same bits.

RUN/run.json        see `RunRecord`
RUN/occupancy.npz   occupancy grid, see `rays.Occupancy`
RUN/history.json    list of {step, seconds, loss, psnr}
RUN/checkpoints/    Orbax checkpoints; the last two are kept
"""

import contextlib
import dataclasses
import os
import time
import warnings
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import jax.numpy as jnp
import numpy as np
import orbax.checkpoint as ocp
from flax import nnx

from lumitree.core.files import (
    WriteError,
    check_space,
    exclusive,
    is_empty,
    remove_written,
    write_json,
)
from lumitree.core.frames import LocalFrame, file_keys, file_members
from lumitree.core.interruption import deferred_interrupt
from lumitree.core.progress import progress
from lumitree.core.reading import Record, label, parse_json, read_bytes
from lumitree.core.seeds import check_seed
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.fit.network.config import TrainConfig
from lumitree.fit.network.rays import Batch, Occupancy, RaySet, load_rays, save_occupancy
from lumitree.fit.network.step import (
    TrainState,
    initial_state,
    make_evaluation,
    make_step,
    psnr,
    state_sharding,
)
from lumitree.lamp.dataset import Dataset

RECORD = "run.json"
OCCUPANCY = "occupancy.npz"
HISTORY = "history.json"
CHECKPOINTS = "checkpoints"
# Patterns of what is in a run's folder. A checkpoint is a folder named after its step.
RUN_FILES = (RECORD, OCCUPANCY, HISTORY, f"{CHECKPOINTS}/[0-9]*")
VERSION = 1
# Size of a checkpoint beside its arrays, about.
_METADATA_BYTES = 1 << 18
_MAX_RECORD_BYTES, _MAX_PATH = 1 << 20, 1 << 14


@dataclasses.dataclass(frozen=True)
class RunRecord:
    """Settings and dataset of a run that extraction needs in addition to the weights."""

    config: TrainConfig
    seed: int
    dataset: str
    fingerprint: str
    luminaire: str
    max_radiance: float
    frame: LocalFrame
    version: int = VERSION

    def __post_init__(self) -> None:
        object.__setattr__(self, "luminaire", label(self.luminaire))
        check_seed(self.seed)
        if not 0 < self.max_radiance < float("inf"):
            raise LumitreeError(f"max_radiance is {self.max_radiance}; expected a positive number")

    def save(self, folder: Path) -> None:
        """Write run.json, atomically."""
        write_json(folder / RECORD, file_members(self))

    @staticmethod
    def load(folder: Path) -> "RunRecord":
        """Read run.json.

        Raises:
            LumitreeError: the file is missing or damaged.
        """
        path = folder / RECORD
        if not path.exists():
            raise LumitreeError(
                f"{folder} holds no {RECORD}; expected a run made by 'lumitree train'"
            )
        text = read_bytes(path, "a run made by 'lumitree train'", _MAX_RECORD_BYTES)
        try:
            return _parse(Record(parse_json(text), "the run"))
        except LumitreeError as error:
            raise LumitreeError(f"{path} is damaged ({error}); train again") from None


def _parse(data: Record) -> RunRecord:
    data.expect_version(VERSION)
    data.expect_keys(*file_keys(RunRecord, "frame"))
    try:
        config = TrainConfig(**data.members("config"))
    except TypeError as error:
        raise LumitreeError(f"config: {shown(error, 200)}") from None
    return RunRecord(
        config=config,
        seed=data.integer("seed"),
        dataset=data.text("dataset", _MAX_PATH),
        fingerprint=data.label("fingerprint"),
        luminaire=data.label("luminaire"),
        max_radiance=data.number("max_radiance"),
        frame=LocalFrame.of_record(data),
    )


@contextmanager
def open_checkpoints(folder: Path) -> Iterator[ocp.CheckpointManager]:
    """The checkpoints of a run; their folder is made if it is missing."""
    # Synchronous: a state is small, and must be on the disk before it is reported as saved.
    options = ocp.CheckpointManagerOptions(max_to_keep=2, enable_async_checkpointing=False)
    # A file for each array: Orbax does not find the parts of its one database (OCDBT) in folders
    # whose name has a bracket, which its search takes for a pattern. It reads both.
    handler = ocp.StandardCheckpointHandler(use_ocdbt=False)
    with ocp.CheckpointManager(
        (folder / CHECKPOINTS).resolve(), options=options, item_handlers=handler
    ) as manager:
        yield manager


def has_checkpoint(folder: Path) -> bool:
    """Whether a run can be resumed."""
    saved = folder / CHECKPOINTS
    return saved.is_dir() and any(entry.name.isdigit() for entry in saved.iterdir())


def save_checkpoint(folder: Path, manager: ocp.CheckpointManager, step: int, state: Any) -> None:
    """Write the state after `step` steps, atomically, unless it was already written."""
    if manager.latest_step() == step:
        return
    try:
        # Orbax prints pages of tracebacks when the disk is full.
        check_space(folder, _METADATA_BYTES + sum(leaf.nbytes for leaf in jax.tree.leaves(state)))
        manager.save(step, args=ocp.args.StandardSave(state))
    except (OSError, ValueError, WriteError) as error:
        with contextlib.suppress(OSError):
            remove_written(folder / CHECKPOINTS, ["*.orbax-checkpoint-tmp"])
        remedy = "choose another output"
        if has_checkpoint(folder):
            remedy = "make the folder writable, and continue with --resume"
        if isinstance(error, WriteError):
            error = OSError(None, error.reason)
        raise WriteError(folder, error, f"a checkpoint to {folder}", remedy) from error


def remove_unfinished(folder: Path, made: bool) -> None:
    """Remove the files of a run that has no checkpoint; and its folder, if lumitree `made` it."""
    if has_checkpoint(folder):
        return
    with contextlib.suppress(OSError):
        remove_written(folder, RUN_FILES)
        if made:
            folder.rmdir()


def restore_checkpoint(folder: Path, template: Any) -> Any:
    """The newest state of a run; its arrays must have the shapes and types of the template's.

    Raises:
        LumitreeError: there is no checkpoint, or the newest is damaged or does not match.
    """
    if not (folder / CHECKPOINTS).is_dir():
        raise LumitreeError(f"{folder} holds no checkpoint: nothing to resume or to extract")
    device = jax.sharding.SingleDeviceSharding(jax.devices()[0])
    placed = jax.tree.map(
        lambda leaf: jax.ShapeDtypeStruct(leaf.shape, leaf.dtype, sharding=device), template
    )
    with open_checkpoints(folder) as manager:
        step = manager.latest_step()
        if step is None:
            raise LumitreeError(f"{folder} holds no checkpoint: nothing to resume or to extract")
        try:
            return manager.restore(step, args=ocp.args.StandardRestore(placed))
        # Orbax and TensorStore raise many types of exceptions for damaged files.
        except Exception as error:
            remedy = "train again, in another folder"
            if len(manager.all_steps()) > 1:
                damaged = manager.directory / str(step)
                remedy = f"remove {damaged} to fall back to the one before it"
            raise LumitreeError(
                f"checkpoint {step} of {folder} is damaged ({type(error).__name__}); {remedy}"
            ) from error


_CHECKPOINT_SECONDS = 60.0
_REPORT_SECONDS = 5.0
# Losses are read back in groups, so that a GPU does not wait for the host.
_STEPS_PER_CHECK = 10
# A report takes about 100 bytes.
_MAX_HISTORY_BYTES = 1 << 26


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
        run_path: folder of the run. It must be missing, empty, or that of a run without a
            checkpoint, which is then started again. With `resume` it may be that of any run.
        config: settings; with `resume` they must equal the settings of the run.
        seed: seed of the initial weights, the batches and the jitter; with `resume` the same.
        resume: continue from the newest checkpoint, if there is one. The result is that of an
            uninterrupted run.
        stop_after: stop and save after this number of steps.

    Raises:
        LumitreeError: the dataset or the folder cannot be used, another process works in the
            folder, the settings are not those of the run, there is nothing to resume, or the loss
            is not finite.
    """
    dataset, folder = Dataset.open(dataset_path), Path(run_path)
    made = not folder.exists()
    _check_folder(folder, config, seed, resume)
    rays, occupancy = load_rays(dataset, config.opacity_kind, config.skip_empty)
    manifest = dataset.manifest
    record = RunRecord(
        config,
        seed,
        str(dataset.folder.resolve()),
        manifest.fingerprint,
        manifest.luminaire,
        rays.max_radiance,
        manifest.local_frame,
    )
    with exclusive(folder):
        # Again, since another process may have worked in the folder meanwhile.
        _check_folder(folder, config, seed, resume)
        try:
            resume = resume and has_checkpoint(folder)
            return _train(folder, record, rays, occupancy, resume, stop_after)
        except WriteError:
            remove_unfinished(folder, made)
            raise


def _train(
    folder: Path,
    record: RunRecord,
    rays: RaySet,
    occupancy: Occupancy,
    resume: bool,
    stop_after: int | None,
) -> TrainResult:
    """Train in a folder that no other process uses; with `resume`, from its newest checkpoint."""
    config = record.config
    graph, state = initial_state(config, rays.typical_part, record.seed)
    history: list[dict[str, float]] = []
    if resume:
        _check_same_data(RunRecord.load(folder), record)
        state = restore_checkpoint(folder, state)
        history = _load_history(folder, int(state.step))
    else:
        record.save(folder)
        save_occupancy(folder / OCCUPANCY, occupancy)
    last = config.num_steps
    if stop_after is not None:
        last = min(last, int(state.step) + stop_after)
    with open_checkpoints(folder) as checkpoints:
        loop = _Loop(folder, rays, occupancy, record, graph, checkpoints, history)
        return loop.run(state, last)


class _Loop:
    """The steps of one call, with reports, checkpoints and history at their intervals."""

    def __init__(
        self,
        folder: Path,
        rays: RaySet,
        occupancy: Occupancy,
        record: RunRecord,
        graph: nnx.GraphDef,
        checkpoints: ocp.CheckpointManager,
        history: list[dict[str, float]],
    ) -> None:
        config = record.config
        self.folder, self.rays, self.config, self.seed = folder, rays, config, record.seed
        self.checkpoints, self.history = checkpoints, history
        self.held_out = rays.held_out()
        self.occupancy = jax.device_put(occupancy, state_sharding(config))
        self.step = make_step(config, graph, rays.max_radiance, record.seed)
        self.evaluate = make_evaluation(config, graph, rays.max_radiance)
        self.earlier = history[-1]["seconds"] if history else 0.0
        self.seconds = self.earlier
        self.pending: list[tuple[jax.Array, jax.Array]] = []

    def run(self, state: TrainState, last: int) -> TrainResult:
        """Train up to step `last` and save the state, unless the loss is not finite."""
        first = done = int(state.step)
        state = jax.device_put(state, state_sharding(self.config))
        start = reported = saved = time.monotonic()
        with (
            deferred_interrupt() as interrupted,
            progress("train", self.config.num_steps, done) as advance,
        ):
            note = ""
            while done < last and not interrupted:
                state, loss, norm = self.step(state, self._draw(done), self.occupancy)
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
                    if now - saved >= _CHECKPOINT_SECONDS:
                        saved = now
                        self._save_or_warn(done, state)
                advance(1, note)
            self._check(done)
            self.seconds = self.earlier + time.monotonic() - start
            self._save(done, state)
        rate = (done - first) * self.config.rays_per_batch / max(self.seconds - self.earlier, 1e-9)
        black = psnr(jnp.zeros(3), self.held_out.radiance, self.rays.max_radiance)
        quality = float(self.evaluate(state.params, self.held_out, self.occupancy))
        return TrainResult(done, self.seconds, quality, float(black), rate, interrupted.number)

    def _draw(self, step: int) -> Batch:
        return self.rays.draw(self.seed, step, self.config.rays_per_batch)

    def _check(self, done: int) -> float:
        """The last loss; refuses losses since the last check that are not finite."""
        values = np.array(jax.device_get(self.pending), np.float64).reshape(-1, 2)
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            step = done - len(values) + int(bad[0]) + 1
            saved = self.checkpoints.latest_step()
            kept = "" if saved is None else f" (the checkpoint of step {saved} there is good)"
            raise LumitreeError(
                f"the loss is not finite at step {step}; lower learning_rate_start, and train in "
                f"another folder than {self.folder}{kept}"
            )
        self.pending.clear()
        return float(values[-1, 0]) if len(values) else float("nan")

    def _report(self, done: int, loss: float, state: TrainState, rate: float) -> str:
        quality = float(self.evaluate(state.params, self.held_out, self.occupancy))
        seconds = round(self.seconds, 3)
        self.history.append({"step": done, "seconds": seconds, "loss": loss, "psnr": quality})
        return f"loss {loss:.3g}, PSNR {quality:.2f} dB, {rate / 1000:.1f} k rays/s"

    def _save_or_warn(self, done: int, state: TrainState) -> None:
        try:
            self._save(done, state)
        except LumitreeError as error:
            warnings.warn(f"{error}; the training continues", LumitreeWarning, stacklevel=2)

    def _save(self, done: int, state: TrainState) -> None:
        # First: of a history that is ahead of the newest checkpoint the end is left out.
        write_json(self.folder / HISTORY, self.history)
        save_checkpoint(self.folder, self.checkpoints, done, state)


def _check_folder(folder: Path, config: TrainConfig, seed: int, resume: bool) -> None:
    """Refuse, before any work, a folder that cannot be used."""
    if not folder.exists() and resume:
        raise LumitreeError(f"{folder} does not exist: nothing to resume")
    if folder.exists() and not folder.is_dir():
        raise LumitreeError(f"{folder} is not a folder; choose another output with -o")
    if not folder.exists() or is_empty(folder):
        return
    if not resume and (has_checkpoint(folder) or not (folder / RECORD).is_file()):
        raise LumitreeError(
            f"{folder} is not empty; continue it with --resume or choose another output with -o"
        )
    if not resume:
        return
    record = RunRecord.load(folder)
    found = dataclasses.asdict(record.config) | {"seed": record.seed}
    wanted = dataclasses.asdict(config) | {"seed": seed}
    changed = [f"{key} {found[key]} -> {wanted[key]}" for key in found if found[key] != wanted[key]]
    if changed:
        raise LumitreeError(
            f"{folder} was trained with other settings ({', '.join(changed)}); use the same ones "
            "to resume, or choose another output with -o"
        )


def _check_same_data(found: RunRecord, wanted: RunRecord) -> None:
    if (found.fingerprint, found.max_radiance) != (wanted.fingerprint, wanted.max_radiance):
        raise LumitreeError(
            f"{wanted.dataset} is not the dataset that the run was trained on ({found.dataset})"
        )


def _load_history(folder: Path, step: int) -> list[dict[str, float]]:
    """Entries up to step `step`, the one of the checkpoint; later steps are repeated."""
    try:
        content = read_bytes(folder / HISTORY, "a history of a training run", _MAX_HISTORY_BYTES)
        entries = Record({"entries": parse_json(content)}, HISTORY).items("entries")
        records = [Record(entry, f"an entry of {HISTORY}") for entry in entries]
        found = [
            {"step": each.integer("step")}
            | {key: each.number(key) for key in ("seconds", "loss", "psnr")}
            for each in records
        ]
    except LumitreeError:
        # It is for reports alone: a damaged one begins anew.
        return []
    return [entry for entry in found if entry["step"] <= step]
