"""`python -m benchmarks NAME [options]`; without a name, the list of benchmarks."""

import argparse
import importlib
import pkgutil
import sys
from collections.abc import Sequence
from typing import Any

import benchmarks
from benchmarks.common.options import Parser, add_common
from benchmarks.common.setting import command_line
from lumitree.core.backend import load_mitsuba
from lumitree.errors import LumitreeError


class _Formatter(argparse.ArgumentDefaultsHelpFormatter, argparse.RawDescriptionHelpFormatter):
    """Shows defaults, and docstrings with their own line breaks."""


def names() -> list[str]:
    """Names of all benchmarks: the modules of this folder."""
    modules = pkgutil.iter_modules(benchmarks.__path__)
    return [each.name for each in modules if not each.ispkg and each.name != "__main__"]


def main(argv: Sequence[str] | None = None) -> int:
    """Run one benchmark, or list all.

    Args:
        argv: arguments without the program's name; None for the process's own.

    Returns:
        The exit status: 0, or 2 for bad input, which is explained in one line.
    """
    argv = sys.argv[1:] if argv is None else argv
    modules = {name: importlib.import_module(f"benchmarks.{name}") for name in names()}
    try:
        if not argv:
            print("usage: python -m benchmarks NAME [options]\n")
            for name, module in modules.items():
                print(f"  {name:<17}{summary(module)}")
            return 0
        options = parser(modules).parse_args(argv)
        options.command = command_line(argv)
        module = modules[options.benchmark]
        if getattr(module, "LOADS_MITSUBA", True):
            load_mitsuba(options.variant)
        module.run(options)
    except LumitreeError as error:
        print(f"benchmarks: error: {error}", file=sys.stderr)
        return 2
    return 0


def parser(modules: dict[str, Any]) -> argparse.ArgumentParser:
    """Parser with a subcommand for each benchmark."""
    whole = Parser(prog="python -m benchmarks", description="Benchmarks of lumitree.")
    commands = whole.add_subparsers(
        dest="benchmark", required=True, metavar="NAME", parser_class=Parser
    )
    for name, module in modules.items():
        command = commands.add_parser(
            name, help=summary(module), description=module.__doc__, formatter_class=_Formatter
        )
        module.add_options(command)
        add_common(command)
    return whole


def summary(module: Any) -> str:
    """First line of a module's docstring."""
    return module.__doc__.partition("\n")[0]


if __name__ == "__main__":
    sys.exit(main())
