"""`lumitree list`."""

import argparse
from typing import Any

from lumitree.cli import options


def add(commands: Any) -> None:
    options.command(commands, "list", "list the built-in luminaires", run, show)


def run(args: argparse.Namespace) -> Any:
    import lumitree

    return {"luminaires": lumitree.builtin_luminaires()}


def show(args: argparse.Namespace, result: Any) -> None:
    for name, item in result["luminaires"].items():
        size = " x ".join(f"{side:.3g}" for side in item["size"])
        print(f"{name:>20}  {item['description']}")
        print(
            f"{'':>20}  {item['triangles']:,} triangles, emitters: {item['emitters']}, of up to "
            f"{item['emitted_radiance']:.4g} W/(m² sr), {size} m, "
            f"{'media' if item['has_media'] else 'no media'}"
        )
