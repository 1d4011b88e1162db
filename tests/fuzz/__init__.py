"""Fuzzing of the readers of files that come from others.

An input is a valid file that is taken apart, changed and put together again, with lengths, offsets
and checksums that are right, so that changes reach the checks behind the first ones. It is made of
the name of its reader, a seed and its number alone: the message of a failure names them.
`LUMITREE_FUZZ_INPUTS=10000 pytest tests/fuzz -k ies` reads so many inputs instead of the few of the
default tests.
"""
