"""The paper's tables, measured again: one cell after the other, and the page that shows them.

    python -m benchmarks paper --scale cpu --rooms FOLDER --minutes 30

Every cell writes its own file of `paper/SCALE/` into the results, and is not measured again while
its parameters are the same. Captures, training runs and assets that cells share are kept in
`--work`. An interrupted run goes on with the same command. The scale `cpu` takes about 5 hours on 2
cores, `paper` days on a GPU, `gpu` hours on one, and `test` minutes; `--list` shows the cells. At
the end the page is written, by default docs/paper.md, with its images beside it in images/paper.
The baselines are the paper's own figures, black images, and the explicit lamp.
"""

import argparse
import time
from pathlib import Path

from benchmarks.common.tables import Table
from benchmarks.paper_tables.cells import Cell, Store
from benchmarks.paper_tables.page import all_cells, write_page
from benchmarks.paper_tables.running import Setting, run_cells
from benchmarks.paper_tables.scales import SCALE_NAMES, SCALES, ScaleName
from lumitree.core.extras import check_network
from lumitree.errors import LumitreeError

PAGE = Path(__file__).parents[1] / "docs" / "paper.md"
# Scales that the page shows together.
SHOWN: tuple[ScaleName, ...] = ("cpu", "gpu", "paper")


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
        "--page", metavar="FILE", type=Path, help="of the page (default: docs/paper.md)"
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
        raise LumitreeError(f"no cells of {', '.join(unknown)}; --list shows those of a scale")
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
        page = PAGE if shown == SHOWN else Path(options.output) / "paper" / name / "page.md"
    images = page.parent / "images" / "paper"
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
        write_page(page, stores, setting.results)

    if not options.page_only:
        check_network()
    try:
        if not options.page_only:
            run_cells(cells, setting, after=show)
    finally:
        show()
    print(f"wrote {page}")
