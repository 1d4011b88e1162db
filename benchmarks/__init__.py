"""Benchmarks of lumitree: `python -m benchmarks NAME`, run from the root of the repository.

Every module of this folder is a benchmark of that name. The first line of its docstring says what
it measures, and it has two functions:

* `add_options(parser)` adds its options to an `argparse.ArgumentParser`. All benchmarks also have
  the options of `common.options.add_common`;
* `run(options)` measures with the parsed options, prints its tables, which include a ratio against
  a baseline measured in the same run, and writes its results with `common.results.Results`.

`common/` is shared by all benchmarks, `equal_error/` by the measurements of time at equal error;
`paper_tables/` has the cells of `paper`.
"""
