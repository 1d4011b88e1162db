"""What the benchmarks share: options, setting, timing, tables and result files."""
