"""`lumitree illuminance`."""

import argparse
from typing import Any, ClassVar

from lumitree.cli import options
from lumitree.cli.output import print_lines, print_open
from lumitree.cli.placements import Grouped, add_placements, placements
from lumitree.errors import LumitreeError, shown


class _OfArea(Grouped):
    into = "areas"
    begins: ClassVar[dict[str, str]] = {"plane": "centre", "surface": "shape"}


def add(commands: Any) -> None:
    text = "illuminance of planes, surfaces and points of a scene, in lux"
    parser = options.command(commands, "illuminance", text, run, show)
    parser.add_argument("scene", metavar="SCENE.xml", help="a Mitsuba 3 scene; needs no camera")
    parser.add_argument(
        "-o",
        dest="output",
        type=options.Output,
        metavar="FILE",
        action="append",
        default=[],
        help="file to write: .csv or .json (each point), .png (plan in false colours with isolux "
        "lines) or .pdf (plan and table); may be repeated",
    )
    add_placements(parser)
    _add_areas(parser)
    parser.add_argument(
        "--error",
        type=float,
        metavar="X",
        default=0.02,
        help="standard error of each point that is enough, relative to its illuminance or to a "
        "tenth of the mean",
    )
    parser.add_argument(
        "--time",
        type=options.duration,
        metavar="T",
        help="time after which no more light is sampled, such as 90s, 5m or 1h",
    )
    parser.add_argument(
        "--direct", action="store_true", help="only light straight from lamps, without reflections"
    )
    options.add_seed(parser, 0)
    options.add_variant(parser)


def _add_areas(parser: argparse.ArgumentParser) -> None:
    parser.add_argument(
        "--plane",
        action=_OfArea,
        type=options.vector(3),
        metavar="X,Y,Z",
        help="centre of a rectangle with a grid of points, scene units; may be repeated, each with "
        "its own --normal, --extent, --spacing and --name",
    )
    parser.add_argument(
        "--surface",
        action=_OfArea,
        metavar="ID",
        help="shape of the scene over which points are spread: its id, the id of its BSDF, or its "
        "number such as '#3'; * and ? stand for any characters. May be repeated, each with its own "
        "--spacing",
    )
    parser.add_argument(
        "--normal",
        action=_OfArea,
        type=options.vector(3),
        metavar="X,Y,Z",
        help="normal of the plane (default: 0,1,0)",
    )
    parser.add_argument(
        "--extent",
        action=_OfArea,
        type=options.vector(2),
        metavar="U,V",
        help="sides of the rectangle; U along the axis x of the scene, or y where the normal is "
        "that of x (default: 1,1)",
    )
    parser.add_argument(
        "--spacing",
        action=_OfArea,
        type=float,
        metavar="S",
        help="distance of neighbouring points (default: 0.25)",
    )
    parser.add_argument(
        "--name", action=_OfArea, metavar="NAME", help="of the plane, for tables and plots"
    )
    parser.add_argument(
        "--points",
        metavar="FILE.csv",
        help="further points: a CSV file with the columns x, y, z, nx, ny, nz",
    )


def run(args: argparse.Namespace) -> Any:
    import lumitree
    from lumitree.measure.illuminance import check_illuminance_output
    from lumitree.measure.receivers import read_points

    for path in args.output:
        check_illuminance_output(path)
    points, normals = (None, None) if args.points is None else read_points(args.points)
    planes, surfaces = _areas(getattr(args, "areas", None) or [])
    result = lumitree.illuminance(
        args.scene,
        placements(args),
        planes=planes,
        surfaces=surfaces,
        points=points,
        normals=normals,
        error=args.error,
        time=args.time,
        direct_only=args.direct,
        unit=options.number(args.unit),
        seed=args.seed,
        variant=args.variant,
    )
    for path in args.output:
        result.save(path)
    return result


def _areas(groups: list[dict[str, Any]]) -> tuple[list[Any], list[Any]]:
    import lumitree

    planes = [lumitree.Plane(**group) for group in groups if "centre" in group]
    surfaces = [group for group in groups if "shape" in group]
    for group in surfaces:
        unfit = sorted(set(group) - {"shape", "spacing"})
        if unfit:
            raise LumitreeError(
                f"--{unfit[0]} is given for --surface {group['shape']}; it is for a --plane"
            )
    return planes, [lumitree.Surface(**group) for group in surfaces]


def show(args: argparse.Namespace, result: Any) -> None:
    from rich.console import Console
    from rich.table import Table
    from rich.text import Text

    kind = "direct illuminance, lx" if result.direct_only else "illuminance, lx"
    table = Table(title=kind)
    for heading in ("area", "points", "mean", "smallest", "largest", "U0", "Ud"):
        table.add_column(heading, justify="left" if heading == "area" else "right")
    for area in result.areas:
        mean = f"{area.mean:.4g} ± {area.mean_error:.2g}"
        values = (f"{area.smallest:.4g}", f"{area.largest:.4g}")
        ratios = (f"{area.uniformity:.3f}", f"{area.diversity:.3f}")
        # Not a string, in which rich would interpret markup.
        name = Text(shown(area.name, 100))
        table.add_row(name, f"{area.count - area.enclosed:,}", mean, *values, *ratios)
    Console().print(table)
    enclosed = sum(area.enclosed for area in result.areas)
    if enclosed:
        print(f"note: {enclosed:,} points are inside solids, and do not count")
    print_lines({f"{stage} (s)": round(value, 1) for stage, value in result.seconds.items()})
    print_open(next(iter(args.output), None))
