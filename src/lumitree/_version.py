"""The version of lumitree."""

__version__ = "0.1.0"
