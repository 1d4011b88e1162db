"""`lumitree info`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_report


def add(commands: Any) -> None:
    parser = options.command(commands, "info", "describe an asset", run)
    parser.add_argument("asset", metavar="ASSET", help=f"a .lumitree file{options.PHOTOMETRIC}")


def run(args: argparse.Namespace) -> Any:
    import lumitree
    from lumitree.api.results import asset_report

    report = {"asset": asset_report(lumitree.load(args.asset), args.asset)}
    print_report(report)
    return report
