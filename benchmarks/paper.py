"""The paper's tables, measured again: one cell after the other, and the page that shows them.

    python -m benchmarks paper --scale cpu --rooms FOLDER --minutes 30

Every cell writes its own file of `paper/SCALE/` into the results, and is not measured again while
its parameters are the same. Captures, training runs and assets that cells share are kept in
`--work`. An interrupted run goes on with the same command. The scale `cpu` takes about 5 hours on 2
cores, `paper` days on a GPU, `gpu` hours on one, and `test` minutes; `--list` shows the cells. At
the end the page `paper.md` is written into the results, with its images in paper/images.
The baselines are the paper's own figures, black images, and the explicit lamp.
"""

import argparse
import dataclasses
import sys
import time
import traceback
from collections.abc import Callable, Sequence
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from pathlib import Path

from benchmarks.common.tables import Table
from benchmarks.paper_tables.cells import Cell, Store
from benchmarks.paper_tables.page import all_cells, write_page
from benchmarks.paper_tables.scales import SCALE_NAMES, SCALES, ScaleName
from benchmarks.paper_tables.work import OutOfTimeError, Work
from lumitree.core.backend import check_network, load_mitsuba
from lumitree.errors import LumitreeError

# Scales that the page shows together.
SHOWN: tuple[ScaleName, ...] = ("cpu", "gpu", "paper")


@dataclasses.dataclass(frozen=True)
class Setting:
    """Settings of the process of a cell.

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
        """Where the results of the cells of the scale are."""
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


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--scale", choices=SCALE_NAMES, default="cpu", help="how large")
    parser.add_argument(
        "--table", type=int, nargs="+", metavar="N", help="cells of these tables only"
    )
    parser.add_argument("--cell", nargs="+", metavar="NAME", help="these cells only")
    parser.add_argument("--minutes", type=float, metavar="M", help="begin no cell after this time")
    parser.add_argument("--list", action="store_true", help="list the cells, and measure nothing")
    parser.add_argument("--page-only", action="store_true", help="write the page, measure nothing")
    parser.add_argument(
        "--rooms", metavar="FOLDER", type=Path, default=Path("rooms"), help="ROOM/room_night.xml"
    )
    parser.add_argument("--work", metavar="FOLDER", type=Path, default=Path("paper.work"))
    parser.add_argument(
        "--page", metavar="FILE", type=Path, help="of the page (default: paper.md of the results)"
    )


def chosen(cells: list[Cell], tables: list[int] | None, names: list[str] | None) -> list[Cell]:
    """The cells of these tables and with these names; None for all.

    Raises:
        LumitreeError: a table has no cells, or there is no cell of a name.
    """
    numbers, known = {cell.table for cell in cells}, {cell.name for cell in cells}
    unknown = [str(table) for table in tables or () if table not in numbers]
    unknown += [name for name in names or () if name not in known]
    if unknown:
        raise LumitreeError(f"no cells of {', '.join(unknown)}; --list shows the cells of a scale")
    return [
        cell
        for cell in cells
        if (tables is None or cell.table in tables) and (names is None or cell.name in names)
    ]


def run(options: argparse.Namespace) -> None:
    name: ScaleName = options.scale
    scale = SCALES[name]
    cells = chosen(all_cells(scale), options.table, options.cell)
    shown: tuple[ScaleName, ...] = SHOWN
    if name not in SHOWN:
        shown = (name,)
    page = options.page
    if page is None:
        folder = Path(options.output)
        page = folder / "paper.md" if shown == SHOWN else folder / "paper" / name / "page.md"
    images = page.parent / "paper" / "images"
    setting = Setting(
        scale=name,
        results=Path(options.output),
        images=images,
        work=options.work,
        rooms=options.rooms,
        variant=options.variant,
        command=options.command,
        end=None if options.minutes is None else time.time() + 60 * options.minutes,
    )
    if options.list:
        states = [(cell, setting.store.state(cell)) for cell in cells]
        rows = [[cell.name, state, f"{cell.minutes:.1f}"] for cell, state in states]
        print(Table(["cell", "state", "minutes"], rows, left=2).text())
        return
    stores: dict[ScaleName, Store] = {each: Store(setting.results, images, each) for each in shown}

    def show() -> None:
        write_page(page, stores)

    if not options.page_only:
        check_network()
    try:
        if not options.page_only:
            run_cells(cells, setting, after=show)
    finally:
        show()
    print(f"wrote {page}")
