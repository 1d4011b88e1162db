"""Options that several benchmarks have."""

import argparse
from pathlib import Path
from typing import NoReturn

from benchmarks.common.results import RESULTS
from lumitree.errors import LumitreeError


class Parser(argparse.ArgumentParser):
    """Argument parser that raises `LumitreeError`."""

    def error(self, message: str) -> NoReturn:
        raise LumitreeError(f"{message}; see '{self.prog} --help'")


def add_common(parser: argparse.ArgumentParser) -> None:
    """`-o` and `--variant`, which all benchmarks have."""
    parser.add_argument(
        "-o",
        "--output",
        metavar="FOLDER",
        type=Path,
        default=RESULTS,
        help="folder of the result files (default: benchmarks/results)",
    )
    parser.add_argument("--variant", metavar="NAME", help="Mitsuba variant (default: llvm_ad_rgb)")


def add_seed(parser: argparse.ArgumentParser) -> None:
    """`--seed`."""
    parser.add_argument("--seed", type=int, default=0, metavar="N", help="of all random numbers")


def add_pixels(parser: argparse.ArgumentParser, option: str, size: int, samples: int) -> None:
    """The size of images in pixels, under the name `option`, and `--spp`."""
    parser.add_argument(option, type=int, metavar="R", default=size, help="of images, pixels")
    parser.add_argument("--spp", type=int, metavar="S", default=samples, help="samples a pixel")
