"""Text is the same however it is encoded and however its lines end."""

import pytest

from lumitree.core.text import in_utf8

LINES = ["v 1 2 3", "# Küche", "", "f 1 2 3"]


@pytest.mark.parametrize("end", ["\n", "\r\n", "\r", "\r\r\n"])
@pytest.mark.parametrize("encoding", ["utf-8", "utf-8-sig", "utf-16", "utf-16-le", "utf-16-be"])
def test_encodings_and_line_ends(encoding, end):
    content = end.join(LINES).encode(encoding)
    assert in_utf8(content).decode().split("\n") == LINES


def test_bytes_of_other_encodings_are_left():
    assert in_utf8("# Küche".encode("latin-1")) == b"# K\xfcche"
    assert in_utf8(b"") == b""
