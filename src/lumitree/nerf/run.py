"""The folder of a training run: what it knows without its dataset, and its checkpoints.

RUN/run.json        see `RunRecord`
RUN/occupancy.npz   cells that may hold something
RUN/history.json    list of {step, seconds, loss, psnr}
RUN/checkpoints/    Orbax; the last two are kept
"""

import dataclasses
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import jax
import orbax.checkpoint as ocp

from lumitree.core.files import write_json
from lumitree.core.frames import check_local_frame
from lumitree.core.reading import Record, label, parse_json, read_bytes
from lumitree.errors import LumitreeError
from lumitree.nerf.config import TrainConfig

RECORD = "run.json"
OCCUPANCY = "occupancy.npz"
HISTORY = "history.json"
CHECKPOINTS = "checkpoints"
# What a run's folder holds, as patterns; a checkpoint is a folder named after its step.
RUN_FILES = (RECORD, OCCUPANCY, HISTORY, f"{CHECKPOINTS}/[0-9]*")
VERSION = 1
_MAX_RECORD_BYTES, _MAX_PATH = 1 << 20, 1 << 14


@dataclasses.dataclass(frozen=True)
class RunRecord:
    """Everything but the weights that extraction needs.

    Attributes:
        config: settings of the run; its law and l_max belong to the field.
        dataset: folder of the training views.
        fingerprint: of the luminaire that the dataset shows.
        luminaire: its name.
        max_radiance: L_max, > 0.
        half_extents: [3] proxy box, local units.
        world_from_proxy: 4 rows of 4.
    """

    config: TrainConfig
    dataset: str
    fingerprint: str
    luminaire: str
    max_radiance: float
    half_extents: tuple[float, ...]
    world_from_proxy: tuple[tuple[float, ...], ...]
    version: int = VERSION

    def __post_init__(self) -> None:
        object.__setattr__(self, "luminaire", label(self.luminaire))
        check_local_frame(self.half_extents, self.world_from_proxy)
        if not 0 < self.max_radiance < float("inf"):
            raise LumitreeError(f"max_radiance is {self.max_radiance}; expected a positive number")

    def save(self, folder: Path) -> None:
        """Write run.json, atomically."""
        write_json(folder / RECORD, dataclasses.asdict(self))

    @staticmethod
    def load(folder: Path) -> "RunRecord":
        """Read run.json.

        Raises:
            LumitreeError: there is none, or it is damaged.
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
    names = {field.name for field in dataclasses.fields(RunRecord)}
    data.expect_keys(*names)
    try:
        config = TrainConfig(**data.members("config"))
    except TypeError as error:
        raise LumitreeError(f"config: {error}") from None
    return RunRecord(
        config=config,
        dataset=data.text("dataset", _MAX_PATH),
        fingerprint=data.label("fingerprint"),
        luminaire=data.label("luminaire"),
        max_radiance=data.number("max_radiance"),
        half_extents=tuple(data.array("half_extents", 3).tolist()),
        world_from_proxy=tuple(map(tuple, data.array("world_from_proxy", 4, 4).tolist())),
    )


@contextmanager
def open_checkpoints(folder: Path) -> Iterator[ocp.CheckpointManager]:
    """The checkpoints of a run, made if there are none."""
    # Synchronous: a state is small, and what was reported as saved must be on the disk.
    options = ocp.CheckpointManagerOptions(max_to_keep=2, enable_async_checkpointing=False)
    with ocp.CheckpointManager((folder / CHECKPOINTS).resolve(), options=options) as manager:
        yield manager


def has_checkpoint(folder: Path) -> bool:
    """Whether a run can be resumed."""
    saved = folder / CHECKPOINTS
    return saved.is_dir() and any(entry.name.isdigit() for entry in saved.iterdir())


def save_checkpoint(manager: ocp.CheckpointManager, step: int, state: Any) -> None:
    """Write the state after `step` steps, atomically; nothing if that is there already.

    Raises:
        LumitreeError: the disk is full or not writable.
    """
    if manager.latest_step() == step:
        return
    try:
        manager.save(step, args=ocp.args.StandardSave(state))
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
        raise LumitreeError(
            f"cannot write a checkpoint to {manager.directory}: {reason}; free some space and "
            "continue with --resume"
        ) from error


def restore_checkpoint(folder: Path, template: Any) -> Any:
    """The newest state of a run.

    Args:
        folder: the run.
        template: tree of the shapes and types that the state must have.

    Raises:
        LumitreeError: there is no checkpoint, or it does not match or is damaged.
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
        # Orbax and TensorStore raise many kinds for damaged files; each means the same here.
        except Exception as error:
            raise LumitreeError(
                f"checkpoint {step} of {folder} is damaged ({type(error).__name__}); "
                f"remove {manager.directory / str(step)} to fall back to the one before it"
            ) from error
