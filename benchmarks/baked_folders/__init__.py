"""Lamps of the benchmark of many lamps, and its runs."""
