"""A model of a farm that bakes many lamps, from what few of them took."""

import dataclasses
from collections.abc import Sequence

import numpy as np

# Assumptions on a shared file system: bytes a second in all, seconds of an operation on a file.
STORAGE_BYTES, OPERATION_SECONDS = 100e6, 0.002
# A claim is made, read and removed; a record, a thumbnail and an asset are each made, flushed and
# renamed; and their folders are looked at.
OPERATIONS_A_LAMP = 20


@dataclasses.dataclass(frozen=True)
class Farm:
    """What the model computes.

    Attributes:
        lamps, machines: their numbers; a machine has one worker of the measured kind.
        bake: seconds of an even division of all bakes.
        dynamic: seconds until the last lamp, if each machine takes the next lamp when it is free.
        tasks: the same, if each machine has its fixed part.
        start: seconds in which a machine starts.
        check: seconds in which a machine checks its part again.
        storage: seconds in which the file system takes all bytes.
        operations: seconds of a machine's operations on files.
        page: seconds of the page.
        bytes: of all assets, records and thumbnails.
    """

    lamps: int
    machines: int
    bake: float
    dynamic: float
    tasks: float
    start: float
    check: float
    storage: float
    operations: float
    page: float
    bytes: float

    @property
    def bound(self) -> str:
        """What bounds the time."""
        terms = {
            "the bakes": self.bake,
            "the bytes of the file system": self.storage,
            "the operations on files": self.operations,
            "the start of the machines": self.start,
            "the page": self.page,
        }
        return max(terms, key=terms.__getitem__)


def farm(
    seconds: Sequence[float],
    lamp_bytes: float,
    check: float,
    start: float,
    page: float,
    *,
    lamps: int,
    machines: int,
) -> Farm:
    """The model: lamps whose seconds are those of the measured ones, in their order, repeated.

    Args:
        seconds: of each measured lamp on one worker.
        lamp_bytes: mean bytes of a lamp's files.
        check, page: seconds of the check of a kept lamp, and of the page for each lamp.
        start: seconds in which a machine starts.
        lamps, machines: their numbers.
    """
    times = np.resize(np.asarray(seconds, float), lamps)
    parts = [times[number::machines].sum() for number in range(machines)]
    free = np.zeros(machines)
    for each in times:
        # The machine that is free first takes the next lamp.
        free[free.argmin()] += each
    a_machine = -(-lamps // machines)
    return Farm(
        lamps=lamps,
        machines=machines,
        bake=float(times.sum() / machines),
        dynamic=float(free.max()),
        tasks=float(max(parts)),
        start=start,
        check=check * a_machine,
        storage=lamps * lamp_bytes / STORAGE_BYTES,
        operations=a_machine * OPERATIONS_A_LAMP * OPERATION_SECONDS,
        page=page * lamps,
        bytes=lamps * lamp_bytes,
    )
