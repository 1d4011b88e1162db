"""`lumitree evaluate`."""

import argparse
from pathlib import Path
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_metrics, print_open


def add(commands: Any) -> None:
    text = "compare an asset with its luminaire: held-out views, and the irradiance around it"
    parser = options.command(commands, "evaluate", text, run, show)
    parser.add_argument("asset", metavar="ASSET", help=f"a .lumitree file{options.PHOTOMETRIC}")
    parser.add_argument(
        "target",
        metavar="LUMINAIRE|DATASET",
        help="the luminaire, of which views are rendered first; or the folder of a dataset, with "
        "which the irradiance is not compared; or a photometric file or an asset, with which only "
        "the irradiance is compared",
    )
    options.add_reading(parser)
    parser.add_argument(
        "-o",
        dest="output",
        type=options.Output,
        metavar="SHEET",
        help="contact sheet, .png (default: the name of ASSET with -evaluation.png); the "
        "irradiance in false colour is written beside it, with -irradiance.png",
    )
    options.add_views(parser, 8, 192, None)
    parser.add_argument(
        "--time",
        type=options.duration,
        metavar="T",
        help="time of the paths of all views, such as 90s or 5m (default: by --spp, or else 8 "
        "seconds of processor time for at most 256 paths per pixel)",
    )
    options.add_irradiance_paths(parser, 1 << 20)
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return lumitree.evaluate(
        args.asset,
        options.luminaire(args, args.target),
        args.output or f"{Path(args.asset).with_suffix('')}-evaluation.png",
        views=args.views,
        resolution=args.resolution,
        spp=args.spp,
        time=args.time,
        irradiance_paths=args.irradiance_paths,
        variant=args.variant,
    )


def show(args: argparse.Namespace, result: Any) -> None:
    print_metrics(result.to_json())
    print_open(result.sheet or result.irradiance_sheet)
