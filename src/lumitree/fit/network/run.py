"""The folder of a training run.

RUN/run.json        see `RunRecord`
RUN/occupancy.npz   occupancy grid, see `occupancy.Occupancy`
RUN/history.json    list of {step, seconds, loss, psnr}
RUN/checkpoints/    Orbax checkpoints; the last two are kept
"""

import contextlib
import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import orbax.checkpoint as ocp

from lumitree.core.files import WriteError, check_room, write_json
from lumitree.core.frames import LocalFrame, file_keys, file_members
from lumitree.core.reading import Record, label, parse_json, read_bytes
from lumitree.core.seeds import check_seed
from lumitree.core.work_folder import remove_written
from lumitree.errors import LumitreeError, shown
from lumitree.fit.network.config import TrainConfig

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
        check_room(folder, _METADATA_BYTES + sum(leaf.nbytes for leaf in jax.tree.leaves(state)))
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
