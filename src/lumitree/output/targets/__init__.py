"""Targets of `lumitree export`: one module for each other program; see `registry`."""
