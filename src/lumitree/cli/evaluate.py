"""`lumitree evaluate`."""

import argparse
from pathlib import Path
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_metrics


def add(commands: Any) -> None:
    text = "compare an asset with held-out views of its luminaire"
    parser = options.command(commands, "evaluate", text, run)
    parser.add_argument("asset", metavar="ASSET", help="a .lumitree file")
    parser.add_argument(
        "target",
        metavar="LUMINAIRE|DATASET",
        help="what to compare with; views of a LUMINAIRE are captured first",
    )
    options.add_reading(parser)
    parser.add_argument(
        "-o",
        dest="output",
        metavar="SHEET",
        help="contact sheet (default: ASSET's name with -evaluation.png)",
    )
    options.add_views(parser, 8, 256, 256)
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    result = lumitree.evaluate(
        args.asset,
        options.luminaire(args, args.target),
        args.output or f"{Path(args.asset).with_suffix('')}-evaluation.png",
        num_views=args.views,
        resolution=args.resolution,
        samples_per_pixel=args.spp,
        variant=args.variant,
    )
    print_metrics(result.to_json())
    return result
