"""`lumitree collect`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_lamps, print_open


def add(commands: Any) -> None:
    text = "write the index page of lamps that were baked by 'bake --task'"
    parser = options.command(commands, "collect", text, run, show)
    parser.add_argument("folder", metavar="FOLDER", help="folder of the assets")


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return lumitree.collect(args.folder)


def show(args: argparse.Namespace, result: Any) -> None:
    print_lamps(result.lamps)
    print_open(result.index)
