"""`lumitree extract`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_result


def add(commands: Any) -> None:
    text = "distil a trained network into an octree asset"
    parser = options.command(commands, "extract", text, run)
    parser.add_argument("run_folder", metavar="RUN", help="folder made by 'lumitree train'")
    options.add_output(parser, "ASSET", "the .lumitree file")
    parser.add_argument(
        "--depth",
        type=int,
        metavar="D",
        default=8,
        help="octree levels, 1 to 10: 2^D cells across the luminaire",
    )


def run(args: argparse.Namespace) -> Any:
    import lumitree

    result = lumitree.extract(args.run_folder, args.output, tree_depth=args.depth)
    print_result(result)
    return result
