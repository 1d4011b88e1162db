"""`lumitree photometry`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import LONGEST_LINE, print_lines, print_open
from lumitree.errors import shown


def add(commands: Any) -> None:
    text = "measure intensities and flux of a lamp; write IES, EULUMDAT and ray files, and reports"
    parser = options.command(commands, "photometry", text, run, show)
    parser.add_argument(
        "source",
        metavar="ASSET|LUMINAIRE",
        help=f"a .lumitree file{options.PHOTOMETRIC}; or: {options.LUMINAIRE}",
    )
    options.add_reading(parser)
    parser.add_argument(
        "-o",
        dest="output",
        type=options.Output,
        metavar="FILE",
        action="append",
        default=[],
        help="file to write: .ies (IES LM-63-2019), .ldt (EULUMDAT), .ray or .tm25ray (IES TM-25 "
        "ray file), .html or .pdf (report); may be repeated",
    )
    parser.add_argument(
        "--step",
        type=float,
        metavar="DEGREES",
        help="angular step, 0.5 to 30, a divisor of 90 (default: the finest of 1, 2.5, 5 and 10 "
        "with at most 2 %% of noise; of an asset 2.5, about half of its bins of direction; of a "
        "photometric file the one that has its angles)",
    )
    parser.add_argument(
        "--unit",
        metavar="UNIT",
        default="m",
        help="unit of length of a scene or an asset: m, cm, mm, in, ft, or the metres in a unit",
    )
    parser.add_argument(
        "--up", choices=("y", "z"), default="y", help="upward axis of a scene or an asset"
    )
    parser.add_argument(
        "--paths", type=int, metavar="N", default=1 << 22, help="light paths, or rays of an asset"
    )
    parser.add_argument(
        "--file-rays",
        type=int,
        metavar="N",
        default=1 << 18,
        help="light paths whose rays a ray file gets",
    )
    parser.add_argument(
        "--seed", type=int, metavar="S", default=0, help="root seed of all random numbers"
    )
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return lumitree.photometry(
        options.luminaire(args, args.source),
        args.output,
        step=args.step,
        unit=options.number(args.unit),
        up=args.up,
        paths=args.paths,
        file_rays=args.file_rays,
        seed=args.seed,
        variant=args.variant,
    )


def show(args: argparse.Namespace, result: Any) -> None:
    from lumitree.measure.photometric_figures import figure_rows

    rows = figure_rows(result, result.size, result.step, result.rays, result.ugr)
    details = {name.replace("_", " "): text for name, text in result.details.items()}
    print_lines({"luminaire": result.luminaire, **details, **dict(rows)})
    _print_near_field(result)
    for path in result.files:
        print(f"written: {shown(path, LONGEST_LINE)}")
    # A report, if there is one.
    reports = [path for path in result.files if path.suffix.lower() in (".html", ".pdf")]
    print_open(next(iter((*reports, *result.files)), None))


def _print_near_field(result: Any) -> None:
    from rich.console import Console
    from rich.table import Table

    from lumitree.measure.photometric_figures import NEAR_FIELD_HEADER, near_field_rows

    table = Table(title="far field, intensity / distance², within 5 %")
    for heading in NEAR_FIELD_HEADER:
        table.add_column(heading, justify="left" if heading == "direction" else "right")
    for row in near_field_rows(result.near_field):
        table.add_row(*row)
    Console().print(table)
