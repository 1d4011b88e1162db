"""`lumitree extract`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_result


def add(commands: Any) -> None:
    text = "convert a trained network into an asset"
    parser = options.command(commands, "extract", text, run, show)
    parser.add_argument(
        "run_folder", metavar="RUN", help="folder of the run, made by 'lumitree train'"
    )
    options.add_output(parser, "ASSET", "the .lumitree file to write")
    parser.add_argument(
        "--tree-depth",
        type=int,
        metavar="D",
        default=8,
        help="tree depth, 1 to 10; there are 2^D leaves along the longest side of the luminaire",
    )
    parser.add_argument(
        "--luminaire",
        metavar="LUMINAIRE",
        help="the luminaire that the views are of; with it the asset gets the light field "
        f"too ({options.LUMINAIRE})",
    )
    options.add_reading(parser)
    options.add_irradiance_paths(parser, None)
    parser.add_argument("--seed", type=int, metavar="S", default=0, help="seed of the light field")
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    luminaire = None if args.luminaire is None else options.luminaire(args, args.luminaire)
    return lumitree.extract(
        args.run_folder,
        args.output,
        tree_depth=args.tree_depth,
        luminaire=luminaire,
        irradiance_paths=args.irradiance_paths,
        seed=args.seed,
        variant=args.variant,
    )


def show(args: argparse.Namespace, result: Any) -> None:
    print_result(result, result.path)
