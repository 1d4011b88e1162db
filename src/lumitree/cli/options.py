"""Options that several commands have."""

import argparse
import contextlib
import math
import os
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Executor
from typing import Any, NoReturn

from lumitree.errors import LumitreeError, shown

LUMINAIRE = "built-in name, Mitsuba 3 scene (.xml) or model (.obj, .gltf, .glb)"

# Files that are taken wherever an asset is.
PHOTOMETRIC = ", or a photometric file (.ies, .ldt, .gldf, .tm33, .ray, .tm25ray)"


class Output(str):
    """Name of a file or a folder that a command writes."""

    __slots__ = ()


class Parser(argparse.ArgumentParser):
    """Argument parser that raises `LumitreeError`."""

    def error(self, message: str) -> NoReturn:
        raise LumitreeError(f"{message}; see '{self.prog} --help'")


class Formatter(argparse.ArgumentDefaultsHelpFormatter):
    """Help formatter that shows defaults, except of flags and of options whose default is None."""

    def _get_help_string(self, action: argparse.Action) -> str | None:
        if action.default in (None, False, []):
            return action.help
        return super()._get_help_string(action)


def command(
    commands: Any,
    name: str,
    text: str,
    run: Callable[[argparse.Namespace], Any],
    show: Callable[[argparse.Namespace, Any], None],
) -> argparse.ArgumentParser:
    """Add a command.

    Args:
        commands: the object that `add_subparsers` returned.
        name: name of the command.
        text: short description, which starts with a verb in lower case.
        run: function that is called with the parsed arguments. It returns a `Result`, or a
            dictionary for `--json`. All files are written when it returns.
        show: function that is called with the parsed arguments and this result, and prints it.

    Returns:
        The parser of the command, to which its options are added.
    """
    parser = commands.add_parser(
        name, help=text, description=text[0].upper() + text[1:] + ".", formatter_class=Formatter
    )
    parser.add_argument(
        "--json", metavar="FILE", type=Output, help="also write the results as JSON to FILE"
    )
    parser.set_defaults(run=run, show=show)
    return parser


def add_luminaire(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Add LUMINAIRE and the options of `add_reading`; `more` is added to the help."""
    parser.add_argument("luminaire", metavar="LUMINAIRE", help=LUMINAIRE + more)
    add_reading(parser)


def add_reading(parser: argparse.ArgumentParser) -> None:
    """Add `--materials`, `--keep` and `--drop`."""
    parser.add_argument(
        "--materials",
        metavar="FILE",
        help="TOML file that overrides materials, unit and up axis of a model (default: the .toml "
        "file with the model's name, if there is one)",
    )
    parser.add_argument(
        "--keep",
        metavar="PATTERN",
        action="append",
        default=[],
        help="take only the shapes (.xml, by id, by their BSDF's id, or by number such as '#3') or "
        "parts (models, by name or material) that match the pattern, with * and ?; may be "
        "repeated; 'preview' lists them",
    )
    parser.add_argument(
        "--drop",
        metavar="PATTERN",
        action="append",
        default=[],
        help="leave out the shapes or parts that match the pattern; may be repeated",
    )


def luminaire(args: argparse.Namespace, name: str) -> Any:
    """`LuminaireSource` of the luminaire `name` and the options of `add_reading`."""
    from lumitree.lamp.source import LuminaireSource

    return LuminaireSource(name, args.materials, tuple(args.keep), tuple(args.drop))


def add_output(parser: argparse.ArgumentParser, metavar: str, text: str) -> None:
    """Add the required option `-o`."""
    parser.add_argument("-o", dest="output", metavar=metavar, type=Output, required=True, help=text)


def add_variant(parser: argparse.ArgumentParser, more: str = "") -> None:
    """Add `--variant`; its help ends with `more`."""
    parser.add_argument(
        "--variant",
        metavar="NAME",
        help="Mitsuba variant; cuda_ad_rgb, for NVIDIA GPUs, is little tested, and metal_ad_rgb, "
        "for Apple silicon, untested (default: llvm_ad_rgb)" + more,
    )


def add_view(parser: argparse.ArgumentParser) -> None:
    """Add `--view` and `--exposure`, by which a .png shows an image."""
    parser.add_argument(
        "--view",
        choices=("standard", "filmic"),
        default="standard",
        help="view transform of a .png: standard, clipped sRGB; or filmic, the transform of ACES "
        "2.0 (`pip install 'lumitree[filmic]'`)",
    )
    parser.add_argument(
        "--exposure",
        type=float,
        metavar="X",
        help="factor on the radiance before the view transform of a .png, such as the one printed "
        "for another image (default: by the log-average luminance of the image)",
    )


def add_views(
    parser: argparse.ArgumentParser, views: int, resolution: int, samples: int | None
) -> None:
    """Add `--views`, `--resolution` and `--spp`, with their defaults; `--spp` may have none."""
    parser.add_argument("--views", type=int, metavar="N", default=views, help="number of views")
    add_pixels(parser, resolution, samples)


def add_pixels(parser: argparse.ArgumentParser, resolution: int, samples: int | None) -> None:
    """Add `--resolution` and `--spp`, with their defaults."""
    parser.add_argument(
        "--resolution", type=int, metavar="R", default=resolution, help="pixels per side of a view"
    )
    parser.add_argument("--spp", type=int, metavar="S", default=samples, help="paths per pixel")


def add_preset(parser: argparse.ArgumentParser) -> None:
    """Add `--preset`."""
    parser.add_argument(
        "--quality",
        choices=("preview", "paper"),
        default="preview",
        help="settings of the network. preview: minutes on 2 CPU cores; paper: hours on a GPU",
    )


def add_budget(parser: argparse.ArgumentParser) -> None:
    """Add `--time`, `--rays` and `--seed`."""
    add_time(parser)
    parser.add_argument(
        "--rays",
        type=int,
        metavar="N",
        help="budget of rays for the gradient descent, instead of --time or in addition to it",
    )
    add_seed(parser, 0)


def add_time(parser: argparse.ArgumentParser) -> None:
    """Add `--time`."""
    parser.add_argument(
        "--time",
        type=duration,
        metavar="T",
        help="budget of time, such as 90s, 5m or 1h (default: that of the quality); the first "
        "estimate of a bake, about 20 seconds, is always completed",
    )


def add_seed(parser: argparse.ArgumentParser, default: int | None) -> None:
    """Add `--seed`."""
    parser.add_argument(
        "--seed",
        type=int,
        metavar="S",
        default=default,
        help="root seed of all random numbers, 0 (default) to 2147483647; with a budget of rays "
        "alone, equal seeds and settings give equal files on one machine",
    )


def add_irradiance_paths(parser: argparse.ArgumentParser, default: int | None) -> None:
    """Add `--irradiance-paths`."""
    by_quality = " (default: by the quality, some seconds)" if default is None else ""
    parser.add_argument(
        "--irradiance-paths",
        type=int,
        metavar="N",
        default=default,
        help="light paths that estimate the irradiance around the luminaire, with which that "
        f"around the asset is compared; 0: it is not compared{by_quality}",
    )


def add_work(parser: argparse.ArgumentParser, default: str = "ASSET with .work") -> None:
    """Add `--work`; `default` is the name of its default, of the output."""
    parser.add_argument(
        "--work",
        metavar="DIR",
        help="folder for the state, which is kept; it must be new, empty or that of an earlier "
        f"call (default: the name of {default}, removed at the end)",
    )


def add_executor(parser: argparse.ArgumentParser, tasks: str) -> None:
    """Add `--workers` and `--scheduler`; `tasks`, in the plural, is what workers share."""
    group = parser.add_mutually_exclusive_group()
    group.add_argument(
        "--workers",
        type=int,
        metavar="N",
        help=f"divide {tasks} among N processes, each of which takes an equal share of the cores "
        "(default: this process does all)",
    )
    group.add_argument(
        "--scheduler",
        metavar="ADDRESS",
        help=f"divide {tasks} among the workers of a Dask scheduler, such as "
        "tcp://192.168.0.2:8786 (`pip install 'lumitree[cluster]'`)",
    )


@contextlib.contextmanager
def executor(args: argparse.Namespace) -> Iterator[Executor | None]:
    """Context with the executor of the options of `add_executor`; None if they are not given.

    At its end tasks that are not finished are stopped.
    """
    from lumitree.core.executor import dask_executor, process_pool

    if args.workers is not None:
        with process_pool(args.workers) as pool:
            yield pool
    elif args.scheduler is not None:
        with dask_executor(args.scheduler) as cluster:
            yield cluster
    else:
        yield None


def check_files(args: argparse.Namespace) -> None:
    """Refuse a file that a command would write twice, or write over one that it reads."""
    texts = list(_texts(list(vars(args).values())))
    read = {_place(text) for text in texts if not isinstance(text, Output)}
    written: set[str] = set()
    for text in (text for text in texts if isinstance(text, Output)):
        place = _place(text)
        if place in written:
            raise LumitreeError(f"{shown(text, 300)} is given for two outputs; name each its own")
        if place in read and os.path.isfile(text):
            raise LumitreeError(
                f"{shown(text, 300)} is read, and would be written over; choose another output"
            )
        written.add(place)


def _texts(values: Iterable[Any]) -> Iterator[str]:
    """The texts among some values, and in their lists and dictionaries."""
    for value in values:
        if isinstance(value, str):
            yield value
        elif isinstance(value, list | tuple):
            yield from _texts(value)
        elif isinstance(value, dict):
            yield from _texts(value.values())


def _place(name: str) -> str:
    """The file that a name stands for, which may have several, as with Lamp.ies and lamp.ies."""
    with contextlib.suppress(OSError, ValueError):
        found = os.stat(name)
        # Some file systems of Windows do not number files.
        if found.st_ino:
            return f"{found.st_dev}:{found.st_ino}"
    return os.path.normcase(os.path.realpath(name))


def duration(text: str) -> float:
    """Parse a duration such as 90, 90s, 5m or 1.5h; returns seconds."""
    factor = {"s": 1, "m": 60, "h": 3600}.get(text[-1:])
    try:
        value = float(text if factor is None else text[:-1]) * (factor or 1)
    except ValueError:
        value = -1.0
    if not 0 < value < math.inf:
        raise argparse.ArgumentTypeError(f"{text!r} is not a duration; write 90s, 5m or 1h")
    return value


def vector(*counts: int) -> Callable[[str], tuple[float, ...]]:
    """Parser of numbers that are separated by commas, as many as one of `counts`."""

    def parse(text: str) -> tuple[float, ...]:
        try:
            values = tuple(float(part) for part in text.split(","))
        except ValueError:
            values = ()
        if len(values) not in counts or not all(math.isfinite(value) for value in values):
            expected = " or ".join(map(str, counts))
            raise argparse.ArgumentTypeError(
                f"{text!r} is not {expected} numbers separated by commas"
            )
        return values

    return parse


def number(text: str) -> float | str:
    """A number, or the text if it is none."""
    try:
        return float(text)
    except ValueError:
        return text
