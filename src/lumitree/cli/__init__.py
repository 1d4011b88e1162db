"""The command line: one file a command, each of which calls one function of `lumitree`."""

from lumitree.cli.app import main

__all__ = ["main"]
