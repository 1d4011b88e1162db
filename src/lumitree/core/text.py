"""Text of files that do not say how they are encoded, names of files, and text in figures."""

import contextlib
import os
import warnings
from collections.abc import Iterator

from lumitree.errors import LumitreeError, shown

# UTF-16 without a byte order mark is recognised by this part of a file.
_PROBE = 400


def in_utf8(content: bytes) -> bytes:
    """The text of a file without its byte order mark, lines ending in \\n.

    UTF-16, with or without a byte order mark, becomes UTF-8. Other encodings are left: UTF-8, or
    one of single bytes.
    """
    if (encoding := utf16_encoding(content)) is not None:
        content = content.decode(encoding, "replace").encode("utf-8", "replace")
    content = content.removeprefix(b"\xef\xbb\xbf")
    if b"\r" in content:
        # Some programs write \r\r\n.
        content = content.replace(b"\r\r\n", b"\n").replace(b"\r\n", b"\n").replace(b"\r", b"\n")
    return content


def check_utf8(path: str | os.PathLike[str]) -> None:
    """Refuse the name of a file that is not UTF-8.

    Mitsuba, OpenEXR and Matplotlib take no other, each with an exception of its own.
    """
    try:
        str(path).encode()
    except UnicodeEncodeError:
        raise LumitreeError(
            f"the name {shown(path, 300)} is not valid UTF-8; rename it, or choose another"
        ) from None


@contextlib.contextmanager
def any_characters() -> Iterator[None]:
    """Context in which Matplotlib draws a box for a character that its font lacks, silently.

    Names of files and lamps may be Chinese; the font of figures has Latin, Greek and Cyrillic.
    """
    with warnings.catch_warnings():
        warnings.filterwarnings("ignore", r"Glyph \d+ .* missing from", UserWarning)
        yield


def utf16_encoding(content: bytes) -> str | None:
    """Name of the encoding of UTF-16, with or without a byte order mark; None for others."""
    if content.startswith((b"\xff\xfe", b"\xfe\xff")):
        return "utf-16"
    start = content[:_PROBE]
    if start.count(0) <= len(start) / 4:
        return None
    # ASCII in UTF-16: every other byte is 0.
    return "utf-16-le" if start[1::2].count(0) > start[::2].count(0) else "utf-16-be"
