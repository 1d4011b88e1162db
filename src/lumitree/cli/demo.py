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
        type=options.Output,
        metavar="DIR",
        default="demo-output",
        help="folder for the images, the report and the asset",
    )
    parser.add_argument(
        "--full",
        action="store_true",
        help="make a radiance field too, and compare views of it: 6 minutes on 2 CPU cores in "
        "place of 1",
    )
    options.add_variant(parser)


def run(args: argparse.Namespace) -> Any:
    from lumitree import demo

    return demo.run(args.output, args.variant, args.full)


def show(args: argparse.Namespace, result: Any) -> None:
    if args.full:
        evaluation = result["evaluate"]
        print_metrics(evaluation)
        metrics = evaluation["metrics"]
        print(
            f"gain over an all-black image: {metrics['gain_linear']:.1f} dB linear, "
            f"{metrics['gain_mulaw']:.1f} dB mu-law"
        )
    else:
        print_report({"irradiance": result["bake"]["irradiance"]})
    print_report({name: result[name] for name in ("seconds", "peak_memory_bytes")})
    print(f"written: {', '.join(result['files'])}")
    print_open(Path(args.output) / "comparison.png")
