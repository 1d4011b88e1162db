"""Tests of `lumitree.lamp.importers.model_files`."""

import struct

import pytest

from lumitree.errors import LumitreeError
from lumitree.lamp.importers.model_files import Images

SIDE = 64


def progressive(scans, between=b""):
    """A grey JPEG file of many scans, each of which leaves all coefficients 0."""

    def segment(marker, data):
        return bytes([0xFF, marker]) + struct.pack(">H", len(data) + 2) + data

    def table(kind, symbol):
        return segment(0xC4, bytes([kind, 1, *[0] * 15, symbol]))

    def scan(first, last, data):
        return segment(0xDA, bytes([1, 1, 0, first, last, 0])) + data + between

    # The codes: no difference of the mean, and a run of 16384 blocks without detail.
    means, run = bytes((SIDE // 8) ** 2 // 8), b"\0\1"
    size = struct.pack(">BHHB", 8, SIDE, SIDE, 1) + bytes([1, 0x11, 0])
    head = segment(0xDB, b"\0" + b"\1" * 64) + segment(0xC2, size) + table(0, 0) + table(16, 0xE0)
    data = scan(0, 0, means) + scan(1, 63, run) * (scans - 1)
    return b"\xff\xd8" + head + data + b"\xff\xd9"


def decoded(data):
    return Images().decoded("a", lambda: data, "a.jpg", ("JPEG", "PNG"))


def test_progressive_images_have_a_limit_of_scans():
    """One of 424 kB with thousands of scans took 23 s."""
    assert (decoded(progressive(100)).pixels == [128, 128, 128, 255]).all()
    with pytest.raises(LumitreeError, match=r"^a.jpg has more than 100 scans; save it as a PNG"):
        decoded(progressive(101))
    # Padding before markers, and markers without a length, hide none.
    for between in (b"\xff\xff", b"\xff\x01", b"\xff\xd0", b"\xff\0"):
        with pytest.raises(LumitreeError, match="more than 100 scans"):
            decoded(progressive(101, between))
