"""Readers that do what no reader may, for tests of the runner: at about one input of three."""

import os
import signal

import numpy as np

from fuzz.reader import MEBIBYTE, Reader

_FILE = "fault"


def make(rng):
    """A file that says whether the reader is at fault."""
    return {_FILE: b"yes" if rng.random() < 1 / 3 else b"no"}


def _reader(name, fault):
    def read(folder):
        if (folder / _FILE).read_bytes() == b"yes":
            fault()

    return Reader(name, make, read, memory=256 * MEBIBYTE)


def _crash():
    os.kill(os.getpid(), signal.SIGSEGV)


def _hang():
    while True:
        pass


def _reserve():
    np.zeros(1 << 34, np.uint8)


def _exit():
    os._exit(3)


READERS = (
    _reader("crash", _crash),
    _reader("hang", _hang),
    _reader("reserve", _reserve),
    _reader("exit", _exit),
)
