"""The program `lumitree`: parses the command line, runs one command, prints errors in one line."""

import contextlib
import errno
import functools
import io
import json
import os
import re
import sys
import warnings
from collections.abc import Iterator, Sequence
from typing import Any

from cyclopts import App, CycloptsError, Parameter, UnknownOptionError, UnusedCliTokensError

from lumitree._version import __version__
from lumitree.cli.commands import COMMANDS, GROUPS, Command, Given, join_groups
from lumitree.cli.output import LONGEST_LINE
from lumitree.cli.signatures import OUTPUTS, with_signature
from lumitree.core.backend import quieten
from lumitree.core.files import remove_abandoned_scratch
from lumitree.core.interruption import (
    STATE_IS_KEPT,
    deferred_interrupt,
    ignore_signals,
    interruptible,
    interruption_behind,
    open_streams,
)
from lumitree.errors import LumitreeError, LumitreeWarning, shown

DEBUG = "LUMITREE_DEBUG"


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
            if isinstance(sys.stdout, io.TextIOWrapper):
                # "?" for characters that the encoding lacks, such as ± in the C locale.
                sys.stdout.reconfigure(errors="replace")
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


def _run(arguments: list[str]) -> int:
    """Run one command; returns the exit status. A signal after its work has no effect."""
    quieten()
    STATE_IS_KEPT.clear()
    with warnings.catch_warnings():
        warnings.showwarning = _show_warning
        warnings.simplefilter("always", LumitreeWarning)
        with interruptible():
            found = _parsed(arguments or ["--help"])
            if found is None:
                return 0
            name, given = found
            _check_files(name, given)
            _check_json_output(given.get("json"))
            # A command that continues a killed one may need no temporary folder itself.
            remove_abandoned_scratch()
            result = COMMANDS[name](given)
        with deferred_interrupt("the work is complete; a second signal ends at once"):
            _show(COMMANDS[name], given, result)
            return _status(result)


def _parsed(arguments: list[str]) -> tuple[str, Given] | None:
    """Name and arguments of a command; None if help or a version was printed instead."""
    name = arguments[0]
    try:
        parser = program(name if name in COMMANDS or name == "--help" else None)
        return parser(join_groups(name, arguments), exit_on_error=False, print_error=False)
    except CycloptsError as error:
        of = f" {name}" if name in COMMANDS else ""
        raise LumitreeError(f"{_problem(name, error)}; see 'lumitree{of} --help'") from None


def _problem(command: str, error: CycloptsError) -> str:
    """A message of cyclopts; an unknown option names the options whose help has its words."""
    if isinstance(error, UnusedCliTokensError):
        return f"too many arguments: {', '.join(map(shown, error.unused_tokens or ()))}"
    # cyclopts also lists the first of the commands.
    text = " ".join(str(error).split()).partition(" Available commands:")[0].rstrip(".")
    if not isinstance(error, UnknownOptionError) or "Did you mean" in text:
        return text
    name = (error.token.keyword or error.token.value).partition("=")[0].strip("-")
    words = re.compile("[-_ ]".join(map(re.escape, re.split("[-_]", name))), re.I)
    options = COMMANDS[command].all_options() if command in COMMANDS else {}
    near = [
        f"--{each.replace('_', '-')}"
        for each in options
        if words.search(options[each].help.partition(". ")[0])
    ]
    return f"{text}{', which may be ' if near else ''}{' or '.join(near)}"


def program(command: str | None = None) -> App:
    """The parser of the command line; calls return the name of a command and its arguments.

    Args:
        command: the one that has options; the others are only listed. Default: all.
    """
    parser = App(
        name="lumitree",
        help="Bake a complex luminaire into a compact emitter for Mitsuba 3.",
        version=f"lumitree {__version__}",
        help_format="plaintext",
        default_parameter=Parameter(negative=()),
        result_action="return_value",
    )
    for name, each in COMMANDS.items():
        called = functools.partial(lambda name, given: (name, given), name)
        options = each.all_options() if command in (None, name) else {}
        parser.command(with_signature(called, *each.help(), options), name=name)
    parser.register_install_completion_command()
    return parser


def _check_files(command: str, given: Given) -> None:
    """Refuse a file that a command would write twice, or write over one that it reads."""
    written: set[str] = set()
    options, texts = COMMANDS[command].all_options(), list(_texts(given))
    outputs = {name for name in OUTPUTS if name in options and not options[name].positional}
    read = {_place(text) for name, text in texts if name not in outputs}
    for text in (text for name, text in texts if name in outputs):
        place = _place(text)
        if place in written:
            raise LumitreeError(f"{shown(text, 300)} is given for two outputs; name two")
        if place in read and os.path.isfile(text):
            raise LumitreeError(
                f"{shown(text, 300)} is read, and would be written over; choose another output"
            )
        written.add(place)


def _texts(given: Given) -> Iterator[tuple[str, str]]:
    """The texts among arguments, and in their lists, with the names of the arguments."""
    for name, value in given.items():
        for each in value if isinstance(value, list | tuple) else [value]:
            if isinstance(each, str):
                yield name, next(iter(json.loads(each).values())) if name in GROUPS else each


def _place(name: str) -> str:
    """The file that a name stands for, which may have several, as with Lamp.ies and lamp.ies."""
    with contextlib.suppress(OSError, ValueError):
        found = os.stat(name)
        # Some file systems of Windows do not number files.
        if found.st_ino:
            return f"{found.st_dev}:{found.st_ino}"
    return os.path.normcase(os.path.realpath(name))


def _show(command: Command, given: Given, result: Any) -> None:
    try:
        command.print(result, given)
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
        if "json" in given:
            from lumitree.core.files import write_json

            write_json(given["json"], result if isinstance(result, dict) else result.to_json())


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
        remains = "nothing of this run is kept; the same command begins as this one did"
        if STATE_IS_KEPT.is_set():
            remains = "the same command continues"
        done = str(interrupted) or remains
        return _fail(f"interrupted; {done}", 128 + interrupted.number)
    if os.environ.get(DEBUG):
        raise error
    if isinstance(error, LumitreeError):
        return _fail(str(error), 2)
    reason = " ".join(str(error).split()) or "no details"
    return _fail(
        f"unexpected {type(error).__name__}: {reason} (set {DEBUG}=1 for the traceback)", 1
    )


def _show_warning(message: Warning | str, *_: object, **__: object) -> None:
    print(f"lumitree: warning: {shown(message, LONGEST_LINE)}", file=sys.stderr)


def _fail(message: str, status: int) -> int:
    print(f"lumitree: error: {shown(message, LONGEST_LINE)}", file=sys.stderr)
    return status
