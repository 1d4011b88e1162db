"""`lumitree demo`."""

import argparse
from pathlib import Path
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_metrics, print_open, print_report


def add(commands: Any) -> None:
    text = "bake a built-in lamp, and compare it with the explicit lamp in a room"
    parser = options.command(commands, "demo", text, run, show)
    parser.add_argument(
        "-o",
        dest="output",
        metavar="DIR",
        default="demo-output",
        help="folder for the images, the report and the asset",
    )
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    from lumitree import demo

    return demo.run(args.output, args.variant)


def show(args: argparse.Namespace, result: Any) -> None:
    evaluation = result["evaluate"]
    print_metrics(evaluation)
    metrics = evaluation["metrics"]
    print(
        f"gain over an all-black image: {metrics['gain_linear']:.1f} dB linear, "
        f"{metrics['gain_mulaw']:.1f} dB mu-law"
    )
    print_report({name: result[name] for name in ("seconds", "peak_memory_bytes")})
    print(f"written: {', '.join(result['files'])}")
    print_open(Path(args.output) / "comparison.png")
