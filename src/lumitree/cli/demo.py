"""`lumitree demo`."""

import argparse
from pathlib import Path
from typing import Any

from lumitree.cli import options
from lumitree.cli.output import print_metrics, print_open, print_report


def add(commands: Any) -> None:
    text = "bake a built-in lamp, and compare it with the explicit lamp in a room"
    parser = options.command(commands, "demo", text, run)
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

    report = demo.run(args.output, args.variant)
    evaluation = report["evaluate"]
    print_metrics(evaluation)
    metrics = evaluation["metrics"]
    print(
        f"gain over an all-black image: {metrics['gain_linear']:.1f} dB linear, "
        f"{metrics['gain_mulaw']:.1f} dB mu-law"
    )
    print_report({name: report[name] for name in ("seconds", "peak_memory_bytes")})
    print(f"written: {', '.join(report['files'])}")
    print_open(Path(args.output) / "comparison.png")
    return report
