"""Runs cells one after the other, each in a process of its own, until the time is spent."""

import dataclasses
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from benchmarks.paper_tables.cells import Cell, Store
from benchmarks.paper_tables.page import all_cells
from benchmarks.paper_tables.scales import SCALES, ScaleName
from benchmarks.paper_tables.work import OutOfTimeError, Work
from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeError


@dataclasses.dataclass(frozen=True)
class Setting:
    """What a cell's process needs to know.

    Attributes:
        scale: name of the scale.
        results, images, work: folders.
        rooms: folder of rooms.
        variant: of Mitsuba; None for the default.
        command: that repeats the run.
        end: `time.time()` at which training stops; None for never.
    """

    scale: ScaleName
    results: Path
    images: Path
    work: Path
    rooms: Path
    variant: str | None
    command: str
    end: float | None

    @property
    def store(self) -> Store:
        """Of the scale's cells."""
        return Store(self.results, self.images, self.scale)

    @property
    def seconds_left(self) -> float | None:
        """Until the end; None if there is none."""
        return None if self.end is None else self.end - time.time()


def run_cell(name: str, setting: Setting) -> bool:
    """Measure one cell; False if the time was spent before it was complete."""
    load_mitsuba(setting.variant)
    scale = SCALES[setting.scale]
    cell = next(cell for cell in all_cells(scale) if cell.name == name)
    left = setting.seconds_left
    deadline = None if left is None else time.monotonic() + left
    work = Work(setting.work / setting.scale, scale, deadline, setting.rooms)
    try:
        setting.store.measure(cell, work, setting.command)
    except OutOfTimeError:
        return False
    return True


def in_child(name: str, setting: Setting) -> bool:
    """As `run_cell`, in a process of its own: the peak of memory is the cell's."""
    with ProcessPoolExecutor(1, get_context("spawn"), max_tasks_per_child=1) as process:
        return process.submit(run_cell, name, setting).result()


def run_cells(
    cells: Sequence[Cell],
    setting: Setting,
    run: Callable[[str, Setting], bool] = in_child,
    after: Callable[[], None] = lambda: None,
) -> None:
    """Measure the cells that have no valid file, until the time is spent.

    A cell is begun if time is left. Training stops at the end; what else has begun is finished.

    Args:
        run: measures one cell, see `run_cell`.
        after: is called after each cell.

    Raises:
        LumitreeError: at the end, if cells could not be measured; or a signal was received.
    """
    failed = []
    for cell in cells:
        if setting.store.state(cell) == "done":
            continue
        left = setting.seconds_left
        if left is not None and left <= 0:
            print("the time is spent; the same command goes on", file=sys.stderr)
            break
        start = time.monotonic()
        try:
            complete = run(cell.name, setting)
        except KeyboardInterrupt:
            raise LumitreeError(f"interrupted in {cell.name}; the same command goes on") from None
        except Exception as error:  # also of a process that the system has killed
            if not isinstance(error, LumitreeError):
                traceback.print_exc()
            failed.append(f"{cell.name}: {error}")
            continue
        word = "measured" if complete else "not complete yet"
        print(f"{cell.name}: {word}, {time.monotonic() - start:.0f} s", file=sys.stderr)
        after()
    if failed:
        raise LumitreeError(f"{len(failed)} cells were not measured: {'; '.join(failed)}")
