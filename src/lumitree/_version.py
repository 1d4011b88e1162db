"""The version of lumitree."""

__version__ = "0.2.0"
