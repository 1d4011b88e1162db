# PYTHON_ARGCOMPLETE_OK
"""The command line. Each command has one file, and calls one function of `lumitree`."""

from lumitree.cli.app import main

__all__ = ["main"]
