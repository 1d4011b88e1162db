"""Shared by the benchmarks: options, setting, timing, tables and result files."""
