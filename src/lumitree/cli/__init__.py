"""The command line: public functions as commands, with what differs."""

from lumitree.cli.app import main

__all__ = ["main"]
