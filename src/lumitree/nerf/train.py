"""Training: Adam on random batches of rays, with checkpoints that continue bit for bit.

Every random number of a step is a function of the seed and the step's index, so the state is
the weights, Adam's moments and the step alone.
"""

import dataclasses
import json
import os
import signal
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

import jax
import jax.numpy as jnp
import numpy as np
import optax
import orbax.checkpoint as ocp
from flax import nnx

from lumitree.core.dataset import Dataset
from lumitree.core.files import write_json
from lumitree.core.progress import progress
from lumitree.errors import LumitreeError
from lumitree.nerf.config import TrainConfig
from lumitree.nerf.losses import psnr, total_loss
from lumitree.nerf.network import CoarseAndFine
from lumitree.nerf.occupancy import Occupancy, save_occupancy
from lumitree.nerf.rays import Batch, RaySet, load_rays
from lumitree.nerf.run import (
    HISTORY,
    OCCUPANCY,
    RunRecord,
    open_checkpoints,
    restore_checkpoint,
    save_checkpoint,
)
from lumitree.nerf.volume import render

_CHECKPOINT_SECONDS = 60.0
_REPORT_SECONDS = 5.0
# Losses are read back in groups, so that a GPU is never left waiting for the host.
_STEPS_PER_CHECK = 10
# Positions evaluated at once on a CPU. Activations of a few thousand stay in its caches, which
# makes a step 2 to 3 times faster than one pass over the batch (2 cores, width 64).
_CPU_POSITIONS = 6000


class TrainState(NamedTuple):
    """Steps done, weights of both networks and Adam's moments."""

    step: jax.Array
    params: Any
    moments: Any


@dataclasses.dataclass(frozen=True)
class TrainResult:
    """What a call of `train` did.

    Attributes:
        steps: steps done in all, earlier calls included.
        seconds: time spent training in all, reading the dataset excluded.
        psnr: of the held-out rays, dB (`losses.psnr`).
        psnr_black: what an all-black prediction scores on them, dB.
        rays_per_second: of this call.
    """

    steps: int
    seconds: float
    psnr: float
    psnr_black: float
    rays_per_second: float


def train(
    dataset_path: str | os.PathLike[str],
    run_path: str | os.PathLike[str],
    config: TrainConfig,
    resume: bool = False,
    stop_after: int | None = None,
) -> TrainResult:
    """Train a NeRF-SH on a dataset (Sec. 4.4), or continue a run.

    Args:
        dataset_path: folder made by `lumitree capture`.
        run_path: folder of the run, new or empty unless `resume`.
        config: settings; those of the run if `resume`.
        resume: continue from the newest checkpoint; same result as without the interruption.
        stop_after: stop and save after so many steps of this call.

    Raises:
        LumitreeError: unusable dataset or folder, another config, nothing to resume, or a
            loss that is not finite.
        KeyboardInterrupt: Ctrl-C, after the state was saved.
    """
    dataset, folder = Dataset.open(dataset_path), Path(run_path)
    _check_folder(folder, config, resume)
    rays, occupancy = load_rays(dataset, config.opacity_kind, config.skip_empty)
    manifest = dataset.manifest
    record = RunRecord(
        config,
        str(dataset.folder.resolve()),
        manifest.fingerprint,
        manifest.luminaire,
        rays.max_radiance,
        manifest.half_extents,
        manifest.world_from_proxy,
    )
    graph, state = initial_state(config)
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
        return _Loop(folder, rays, occupancy, config, graph, checkpoints, history).run(state, last)


def initial_state(config: TrainConfig) -> tuple[nnx.GraphDef, TrainState]:
    """The networks' structure and the state before the first step."""
    graph, weights = nnx.split(CoarseAndFine(config))
    params = nnx.to_pure_dict(weights)
    return graph, TrainState(jnp.zeros((), jnp.int32), params, _optimizer(config).init(params))


def make_step(
    config: TrainConfig, graph: nnx.GraphDef, max_radiance: float
) -> Callable[[TrainState, Batch, Occupancy], tuple[TrainState, jax.Array, jax.Array]]:
    """The jitted training step: to the next state, its loss and gradient norm.

    The state that is passed in is donated: it cannot be used again.
    """
    optimizer = _optimizer(config)
    num_chunks = _num_chunks(config, config.rays_per_batch)

    def loss_of(params: Any, occupancy: Occupancy, rays: Batch, key: jax.Array) -> jax.Array:
        networks = nnx.merge(graph, params)
        coarse, fine = render(
            networks, occupancy, rays.origins, rays.directions, max_radiance, config, key
        )
        return total_loss(coarse, fine, rays.radiance, rays.opacity, config.stop_gradient)

    def step(
        state: TrainState, batch: Batch, occupancy: Occupancy
    ) -> tuple[TrainState, jax.Array, jax.Array]:
        def add_chunk(total: Any, chunk: tuple[Batch, jax.Array]) -> tuple[Any, None]:
            value = jax.value_and_grad(loss_of)(state.params, occupancy, *chunk)
            return jax.tree.map(jnp.add, total, value), None

        keys = jax.random.split(
            jax.random.fold_in(jax.random.key(config.seed), state.step), num_chunks
        )
        chunks = jax.tree.map(lambda x: x.reshape(num_chunks, -1, *x.shape[1:]), batch)
        zero = (jnp.zeros(()), jax.tree.map(jnp.zeros_like, state.params))
        total, _ = jax.lax.scan(add_chunk, zero, (chunks, keys))
        loss, gradients = jax.tree.map(lambda x: x / num_chunks, total)
        updates, moments = optimizer.update(gradients, state.moments)
        params = optax.apply_updates(state.params, updates)
        return (
            TrainState(state.step + 1, params, moments),
            loss,
            optax.global_norm(gradients),
        )

    return jax.jit(step, donate_argnums=0)


def make_evaluation(
    config: TrainConfig, graph: nnx.GraphDef, max_radiance: float
) -> Callable[[Any, Batch, Occupancy], jax.Array]:
    """Jitted (weights, batch, occupancy) to the PSNR of the fine network on the batch, dB."""

    def evaluate(params: Any, batch: Batch, occupancy: Occupancy) -> jax.Array:
        networks = nnx.merge(graph, params)

        def see(rays: Batch) -> jax.Array:
            _, fine = render(
                networks, occupancy, rays.origins, rays.directions, max_radiance, config, None
            )
            return fine.radiance

        num_chunks = _num_chunks(config, len(batch.opacity))
        chunks = jax.tree.map(lambda x: x.reshape(num_chunks, -1, *x.shape[1:]), batch)
        predicted = jax.lax.map(see, chunks).reshape(-1, 3)
        return psnr(predicted, batch.radiance, max_radiance)

    return jax.jit(evaluate)


class _Loop:
    """The steps of one call, with reports, checkpoints and history at their intervals."""

    def __init__(
        self,
        folder: Path,
        rays: RaySet,
        occupancy: Occupancy,
        config: TrainConfig,
        graph: nnx.GraphDef,
        checkpoints: ocp.CheckpointManager,
        history: list[dict[str, float]],
    ) -> None:
        self.folder, self.rays, self.config = folder, rays, config
        self.checkpoints, self.history = checkpoints, history
        self.held_out = rays.held_out()
        self.occupancy = jax.device_put(occupancy)
        self.step = make_step(config, graph, rays.max_radiance)
        self.evaluate = make_evaluation(config, graph, rays.max_radiance)
        self.earlier = history[-1]["seconds"] if history else 0.0
        self.seconds = self.earlier
        self.pending: list[tuple[jax.Array, jax.Array]] = []

    def run(self, state: TrainState, last: int) -> TrainResult:
        """Train up to step `last`; the state is saved however this ends, unless it is bad."""
        first = done = int(state.step)
        start = reported = saved = time.monotonic()
        with (
            _deferred_interrupt() as interrupted,
            progress("train", self.config.num_steps, done) as advance,
        ):
            while done < last and not interrupted.is_set():
                state, *health = self.step(state, self._draw(done), self.occupancy)
                self.pending.append(tuple(health))
                done += 1
                note = ""
                if len(self.pending) >= _STEPS_PER_CHECK or done == last:
                    loss = self._check(done)
                    now = time.monotonic()
                    self.seconds = self.earlier + now - start
                    if now - reported >= _REPORT_SECONDS or done == last:
                        reported = now
                        speed = (done - first) * self.config.rays_per_batch / (now - start)
                        note = self._report(done, loss, state, speed)
                    if now - saved >= _CHECKPOINT_SECONDS:
                        saved = now
                        self._save(done, state)
                advance(1, note)
            self._check(done)
            self._save(done, state)
            if interrupted.is_set():
                raise KeyboardInterrupt
        rate = (done - first) * self.config.rays_per_batch / max(self.seconds - self.earlier, 1e-9)
        black = psnr(jnp.zeros(3), self.held_out.radiance, self.rays.max_radiance)
        quality = float(self.evaluate(state.params, self.held_out, self.occupancy))
        return TrainResult(done, self.seconds, quality, float(black), rate)

    def _draw(self, step: int) -> Batch:
        return self.rays.draw(self.config.seed, step, self.config.rays_per_batch)

    def _check(self, done: int) -> float:
        """The last loss, after making sure that every one since the last check is finite."""
        values = np.array(jax.device_get(self.pending), np.float64).reshape(-1, 2)
        bad = np.flatnonzero(~np.isfinite(values).all(axis=1))
        if bad.size:
            step = done - len(values) + int(bad[0]) + 1
            raise LumitreeError(
                f"the loss is not finite at step {step}; the last checkpoint of {self.folder} is "
                "good: lower learning_rate_start and train again"
            )
        self.pending.clear()
        return float(values[-1, 0]) if len(values) else float("nan")

    def _report(self, done: int, loss: float, state: TrainState, rate: float) -> str:
        quality = float(self.evaluate(state.params, self.held_out, self.occupancy))
        seconds = round(self.seconds, 3)
        self.history.append({"step": done, "seconds": seconds, "loss": loss, "psnr": quality})
        return f"loss {loss:.3g}, PSNR {quality:.2f} dB, {rate / 1000:.1f} k rays/s"

    def _save(self, done: int, state: TrainState) -> None:
        save_checkpoint(self.checkpoints, done, state)
        write_json(self.folder / HISTORY, self.history)


def _optimizer(config: TrainConfig) -> optax.GradientTransformation:
    decay = config.learning_rate_end / config.learning_rate_start
    schedule = optax.exponential_decay(config.learning_rate_start, config.num_steps, decay)
    return optax.adam(schedule)


def _num_chunks(config: TrainConfig, num_rays: int) -> int:
    """Equal parts in which a batch is evaluated: one on a GPU, parts that fit caches on a CPU."""
    if jax.default_backend() != "cpu":
        return 1
    positions = num_rays * (2 * config.num_coarse + config.num_fine)
    wanted = min(num_rays, -(-positions // _CPU_POSITIONS))
    return next(count for count in range(wanted, num_rays + 1) if num_rays % count == 0)


def _check_folder(folder: Path, config: TrainConfig, resume: bool) -> None:
    """Refuse, before any work, a folder that cannot be used."""
    if not resume:
        if folder.exists() and (not folder.is_dir() or any(folder.iterdir())):
            raise LumitreeError(
                f"{folder} is not empty; continue it with --resume or choose another output with -o"
            )
        return
    if not folder.is_dir():
        raise LumitreeError(f"{folder} does not exist: nothing to resume")
    found, wanted = dataclasses.asdict(RunRecord.load(folder).config), dataclasses.asdict(config)
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
    """Entries up to the checkpoint; what came after it is trained again."""
    try:
        entries = json.loads((folder / HISTORY).read_text(encoding="utf-8"))
        return [entry for entry in entries if entry["step"] <= step]
    except (OSError, ValueError, TypeError, KeyError):
        return []


@contextmanager
def _deferred_interrupt() -> Iterator[threading.Event]:
    """Ctrl-C sets an event, so that a step is never cut in half; a second one kills at once."""
    interrupted = threading.Event()
    if threading.current_thread() is not threading.main_thread():
        yield interrupted
        return
    previous = signal.getsignal(signal.SIGINT)

    def remember(*_: Any) -> None:
        interrupted.set()
        signal.signal(signal.SIGINT, previous)

    signal.signal(signal.SIGINT, remember)
    try:
        yield interrupted
    finally:
        signal.signal(signal.SIGINT, previous)
