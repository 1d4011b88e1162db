"""`lumitree capture`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_result


def add(commands: Any) -> None:
    text = "render views of a luminaire: radiance and opacity"
    parser = options.command(commands, "capture", text, run, show)
    options.add_luminaire(parser)
    options.add_output(
        parser, "DATASET", "folder for the views; the same command continues an interrupted capture"
    )
    parser.add_argument(
        "--split",
        choices=("train", "test"),
        default="train",
        help="set of view directions; the two have none in common",
    )
    options.add_views(parser, 100, 256, 128)
    options.add_variant(parser)
    options.add_executor(parser, "the views")


def run(args: argparse.Namespace) -> Any:
    import lumitree

    with options.executor(args) as executor:
        return lumitree.capture(
            options.luminaire(args, args.luminaire),
            args.output,
            views=args.views,
            resolution=args.resolution,
            spp=args.spp,
            split=args.split,
            variant=args.variant,
            executor=executor,
        )


def show(args: argparse.Namespace, result: Any) -> None:
    print_result(result, result.dataset)
