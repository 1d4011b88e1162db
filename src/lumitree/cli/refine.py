"""`lumitree refine`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_result


def add(commands: Any) -> None:
    text = "improve an asset with rays traced through its luminaire"
    parser = options.command(commands, "refine", text, run, show)
    parser.add_argument("asset", metavar="ASSET", help="a .lumitree file, baked with either method")
    options.add_luminaire(parser)
    options.add_output(
        parser,
        "ASSET",
        "the .lumitree file to write; the same command continues an interrupted call",
    )
    options.add_budget(parser)
    options.add_irradiance_paths(parser, None)
    options.add_work(parser)
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return lumitree.refine(
        args.asset,
        options.luminaire(args, args.luminaire),
        args.output,
        time=args.time,
        rays=args.rays,
        irradiance_paths=args.irradiance_paths,
        seed=args.seed,
        work=args.work,
        variant=args.variant,
    )


def show(args: argparse.Namespace, result: Any) -> None:
    print_result(result, result.path)
