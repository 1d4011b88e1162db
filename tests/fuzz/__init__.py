"""Fuzzing of the readers of files: `python -m tests.fuzz --help`, from the root of the repository.

An input is a valid file that is taken apart, changed and put together again, with lengths, offsets
and checksums that are right, so that changes reach the checks behind the first ones. It is made of
the name of its reader, a seed and its number alone: one command repeats it. `reader.Reader`
describes what a reader is and what has to hold; `registry` lists all of them.
"""
