"""`lumitree merge`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_result


def add(commands: Any) -> None:
    text = "combine light fields of one luminaire that were baked with different seeds"
    parser = options.command(commands, "merge", text, run, show)
    parser.add_argument(
        "assets",
        metavar="ASSET",
        nargs="+",
        help=".lumitree files, at least two; all other parts are those of the first that has a "
        "field",
    )
    options.add_output(parser, "ASSET", "the .lumitree file to write")


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return lumitree.merge(args.assets, args.output)


def show(args: argparse.Namespace, result: Any) -> None:
    print_result(result, result.path)
