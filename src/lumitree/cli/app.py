"""The program `lumitree`: parses the command line, runs one command, prints errors in one line."""

import argparse
import errno
import io
import os
import sys
import warnings
from collections.abc import Sequence
from typing import Any

from lumitree.cli import (
    bake,
    blender_extension,
    capture,
    collect,
    demo,
    evaluate,
    export,
    extract,
    illuminance,
    info,
    list_luminaires,
    mix,
    photometry,
    preview,
    refine,
    render,
    train,
    view,
)
from lumitree.cli.completion import complete
from lumitree.cli.options import Parser, check_files
from lumitree.cli.output import LONGEST_LINE
from lumitree.core.backend import quieten
from lumitree.core.files import remove_abandoned_scratch
from lumitree.core.interruption import (
    deferred_interrupt,
    ignore_signals,
    interruptible,
    interruption_behind,
    open_streams,
)
from lumitree.errors import LumitreeError, LumitreeWarning, shown

DEBUG = "LUMITREE_DEBUG"
# Options whose values may begin with a minus sign, which argparse would parse as an option.
_VECTOR_OPTIONS = ("--at", "--rotate", "--gain", "--plane", "--normal")
_COMMANDS = (
    list_luminaires,
    preview,
    capture,
    train,
    extract,
    bake,
    collect,
    refine,
    mix,
    info,
    evaluate,
    photometry,
    illuminance,
    render,
    view,
    export,
    blender_extension,
    demo,
)


def main(argv: Sequence[str] | None = None) -> int:
    """Run one command.

    Args:
        argv: arguments of the command line. Default: the arguments of the process.

    Returns:
        The exit status: 0 for success, 1 for an error in lumitree, 2 for invalid input, and 128
        plus the number of the signal if the command was interrupted.
    """
    try:
        if argv is None:
            open_streams()
            _print_all_characters()
        return _run(list(sys.argv[1:] if argv is None else argv))
    except BrokenPipeError:
        # The program that reads the output, such as `head`, has closed it.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        return 0
    except (Exception, KeyboardInterrupt) as error:
        return _explain(error)
    finally:
        if argv is None:
            ignore_signals()


def _print_all_characters() -> None:
    """Print "?" for characters that the encoding of the output lacks, such as ± in the C locale."""
    if isinstance(sys.stdout, io.TextIOWrapper):
        sys.stdout.reconfigure(errors="replace")


def _run(arguments: list[str]) -> int:
    """Run one command; returns the exit status. A signal after its work has no effect."""
    quieten()
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        warnings.simplefilter("always", LumitreeWarning)
        with interruptible():
            parser = _parser()
            complete(parser)
            args = parser.parse_args(_join_vectors(arguments or ["--help"]))
            check_files(args)
            _check_json_output(args.json)
            # A command that continues a killed one may need no temporary folder itself.
            remove_abandoned_scratch()
            result = args.run(args)
        with deferred_interrupt("the work is complete; a second signal ends at once"):
            _show(args, result)
            return _status(result)


def _show(args: argparse.Namespace, result: Any) -> None:
    try:
        args.show(args, result)
        sys.stdout.flush()
    except OSError as error:
        # On Windows the error is only an invalid argument.
        if isinstance(error, BrokenPipeError) or (os.name == "nt" and error.errno == errno.EINVAL):
            raise BrokenPipeError from error
        # Else the end of the process tries to write the same again.
        os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())
        raise LumitreeError(
            f"cannot print the results: {error.strerror or error}; print them elsewhere"
        ) from error
    finally:
        if args.json:
            from lumitree.core.files import write_json

            write_json(args.json, result if isinstance(result, dict) else result.to_json())


def _status(result: Any) -> int:
    """Exit status of a command that has returned; prints one line if it was interrupted."""
    number = getattr(result, "stopped_by", None)
    if number is None or result.finished:
        problem = getattr(result, "problem", None)
        return 0 if problem is None else _fail(problem, 2)
    path = getattr(result, "path", None)
    if path is not None and getattr(result, "complete", False):
        done = f"the asset in {path} is complete, but its irradiance was not compared"
        return _fail(f"interrupted; {done}", 128 + number)
    best = f"the best asset so far is in {path}; " if path is not None else ""
    how = getattr(result, "continues", "the same command continues")
    return _fail(f"interrupted; {best}{how}", 128 + number)


def _check_json_output(path: str | None) -> None:
    """Refuse a file for the results that cannot be written; makes no folder for it."""
    if path is None:
        return
    from lumitree.core.files import check_writable

    folder = os.path.dirname(path) or "."
    if not os.path.isdir(folder):
        raise LumitreeError(
            f"--json: there is no folder {shown(folder, 300)}; make it, or choose another"
        )
    check_writable(path)


def _explain(error: BaseException) -> int:
    """Print an error in one line; returns the exit status."""
    interrupted = interruption_behind(error)
    if interrupted is not None:
        done = str(interrupted) or "the same command continues where that is possible"
        return _fail(f"interrupted; {done}", 128 + interrupted.number)
    if os.environ.get(DEBUG):
        raise error
    if isinstance(error, LumitreeError):
        return _fail(str(error), 2)
    reason = " ".join(str(error).split()) or "no details"
    return _fail(
        f"unexpected {type(error).__name__}: {reason} (set {DEBUG}=1 for the traceback)", 1
    )


def _show_warning(message: Warning | str, *_: Any, **__: Any) -> None:
    print(f"lumitree: warning: {shown(message, LONGEST_LINE)}", file=sys.stderr)


def _fail(message: str, status: int) -> int:
    print(f"lumitree: error: {shown(message, LONGEST_LINE)}", file=sys.stderr)
    return status


def _join_vectors(arguments: list[str]) -> list[str]:
    joined: list[str] = []
    for argument in arguments:
        if joined and joined[-1] in _VECTOR_OPTIONS:
            joined[-1] += f"={argument}"
        else:
            joined.append(argument)
    return joined


def _parser() -> Parser:
    parser = Parser(
        prog="lumitree",
        description="Bake a complex luminaire into a compact emitter for Mitsuba 3.",
        epilog="LUMINAIRE is a built-in name (see 'lumitree list'), a Mitsuba 3 scene (.xml), or a "
        "model (.obj, .gltf, .glb) with an optional .toml of the same name beside it; see "
        "docs/bring-your-own-lamp.md.",
    )
    from lumitree import __version__

    parser.add_argument("--version", action="version", version=f"lumitree {__version__}")
    commands = parser.add_subparsers(required=True, metavar="COMMAND", parser_class=Parser)
    for command in _COMMANDS:
        command.add(commands)
    return parser
