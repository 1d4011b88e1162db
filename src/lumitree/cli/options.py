"""Options that several commands share."""

import argparse
import math
from collections.abc import Callable
from typing import Any, NoReturn

from lumitree.errors import LumitreeError

LUMINAIRE = "built-in name, Mitsuba 3 scene (.xml) or model (.obj, .gltf, .glb)"


class Parser(argparse.ArgumentParser):
    """A parser whose errors are those of lumitree."""

    def error(self, message: str) -> NoReturn:
        raise LumitreeError(f"{message}; see '{self.prog} --help'")


class Formatter(argparse.ArgumentDefaultsHelpFormatter):
    """Shows defaults, except of flags and of options whose help says what happens without."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default in (None, False):
            return action.help
        return super()._get_help_string(action)


def command(
    commands: Any, name: str, text: str, run: Callable[[argparse.Namespace], Any]
) -> argparse.ArgumentParser:
    """Add a command.

    Args:
        commands: what `add_subparsers` returned.
        name: of the command.
        text: what it does, in a few words.
        run: called with the parsed arguments; prints, and returns a `Result`.
    """
    parser = commands.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + ".", formatter_class=Formatter
    )
    parser.add_argument("--json", metavar="FILE", help="also write the results as JSON to FILE")
    parser.set_defaults(run=run)
    return parser


def add_luminaire(parser: argparse.ArgumentParser, more: str = "") -> None:
    """LUMINAIRE and what changes how it is read."""
    parser.add_argument("luminaire", metavar="LUMINAIRE", help=LUMINAIRE + more)
    add_reading(parser)


def add_reading(parser: argparse.ArgumentParser) -> None:
    """What changes how a luminaire is read."""
    parser.add_argument(
        "--materials",
        metavar="FILE",
        help="TOML overrides of a model's materials, unit and up axis (default: the .toml beside "
        "the model, if there is one)",
    )
    parser.add_argument(
        "--keep",
        metavar="PATTERN",
        action="append",
        default=[],
        help="take only the shapes (.xml, by id) or parts (models, by part or material) whose name "
        "matches, with * and ?; may be repeated",
    )
    parser.add_argument(
        "--drop",
        metavar="PATTERN",
        action="append",
        default=[],
        help="leave out what matches; may be repeated",
    )


def luminaire(args: argparse.Namespace, name: str) -> Any:
    """What LUMINAIRE and the options of `add_reading` name."""
    from lumitree.luminaire.source import LuminaireSource

    return LuminaireSource(name, args.materials, tuple(args.keep), tuple(args.drop))


def add_output(parser: argparse.ArgumentParser, metavar: str, text: str) -> None:
    """`-o`, which is required."""
    parser.add_argument("-o", dest="output", metavar=metavar, required=True, help=text)


def add_variant(parser: argparse.ArgumentParser) -> None:
    """`--variant`."""
    parser.add_argument(
        "--variant",
        metavar="NAME",
        help="Mitsuba variant (default: cuda_ad_rgb where there is a GPU, else llvm_ad_rgb)",
    )


def add_views(parser: argparse.ArgumentParser, views: int, resolution: int, samples: int) -> None:
    """`--views`, `--resolution` and `--spp`."""
    parser.add_argument("--views", type=int, metavar="N", default=views, help="number of views")
    add_pixels(parser, resolution, samples)


def add_pixels(parser: argparse.ArgumentParser, resolution: int, samples: int) -> None:
    """`--resolution` and `--spp`."""
    parser.add_argument(
        "--resolution", type=int, metavar="R", default=resolution, help="pixels a side"
    )
    parser.add_argument("--spp", type=int, metavar="S", default=samples, help="paths a pixel")


def add_preset(parser: argparse.ArgumentParser, default: str | None = "preview") -> None:
    """`--preset`."""
    parser.add_argument(
        "--preset",
        choices=("preview", "paper"),
        default=default,
        help="preview: minutes on 2 CPU cores; paper: the paper's settings, days on a GPU",
    )


def add_budget(parser: argparse.ArgumentParser, seed: int | None = 0) -> None:
    """`--time`, `--rays` and `--seed`."""
    parser.add_argument(
        "--time",
        type=duration,
        metavar="T",
        help="budget such as 90s, 5m or 1h (default: the quality's); a first estimate, of some 20 "
        "seconds, is always made where there is none",
    )
    parser.add_argument(
        "--rays", type=int, metavar="N", help="budget of refinement rays, besides or without --time"
    )
    parser.add_argument(
        "--seed",
        type=int,
        metavar="S",
        default=seed,
        help="root seed of all random numbers, 0 (default) to 2147483647; with --rays alone, equal "
        "seeds and settings give equal files on one machine",
    )


def add_work(parser: argparse.ArgumentParser) -> None:
    """`--work`."""
    parser.add_argument(
        "--work",
        metavar="DIR",
        help="keep intermediate results in DIR, which must be empty, new or an earlier bake's "
        "(default: a folder beside ASSET, removed at the end)",
    )


def duration(text: str) -> float:
    """Seconds of a text such as 90, 90s, 5m or 1.5h."""
    factor = {"s": 1, "m": 60, "h": 3600}.get(text[-1:])
    try:
        value = float(text if factor is None else text[:-1]) * (factor or 1)
    except ValueError:
        value = -1.0
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration; write 90s, 5m or 1h")
    return value
