"""Fuzzing of the readers of files that come from others, by hypothesis.

An input is a valid file that is taken apart, changed and put together again, with lengths, offsets
and checksums that are right, so that changes reach the checks behind the first ones.
`LUMITREE_FUZZ_INPUTS=10000 pytest tests/fuzz -k ies` reads 10,000 inputs instead of the few of the
default tests.
"""
