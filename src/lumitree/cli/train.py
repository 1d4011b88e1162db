"""`lumitree train`."""

import argparse
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_result


def add(commands: Any) -> None:
    text = "train the network of the paper on a dataset"
    parser = options.command(commands, "train", text, run, show)
    parser.add_argument(
        "dataset", metavar="DATASET", help="folder of the dataset, made by 'lumitree capture'"
    )
    options.add_output(parser, "RUN", "folder of the run, for checkpoints and history")
    options.add_preset(parser)
    parser.add_argument(
        "--seed", type=int, metavar="S", default=0, help="seed of all random numbers"
    )
    parser.add_argument("--resume", action="store_true", help="continue an interrupted run")


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return lumitree.train(
        args.dataset, args.output, quality=args.quality, seed=args.seed, resume=args.resume
    )


def show(args: argparse.Namespace, result: Any) -> None:
    print_result(result, result.run)
