"""Seeded damage to files, and the check that it is refused in a line."""

import warnings

from lumitree.errors import LumitreeError, LumitreeWarning

TOKENS = (
    b"-1", b"0", b"1e308", b"-1e-308", b"nan", b"inf", b"1e999", b"9" * 30, b"-9223372036854775808",
    b"9223372036854775807", b"1" * 5000, b"x" * 3000, b"../a", b"/etc/passwd", b"\\", b"/", b"#",
    b'"', b"'", b"[" * 50, b"{", b"]", b"<", b"&#0;", b"\x00", b"\x1b[31m", b"\xff\xfe", b"\r",
    b"\xed\xa0\x80", "é".encode(), b"f 1 2 3", b"usemtl", b"-", b"=", b"",
)  # fmt: skip


def damaged(text, rng, separators=(b" ",), tokens=()):
    """Text with some of its bytes, words or lines changed, dropped, repeated or cut off.

    Args:
        separators: of words on a line.
        tokens: words of the format, which may replace others.
    """
    separators, tokens = (b"\n", *separators), (*TOKENS, *tokens)
    for _ in range(rng.integers(1, 4)):
        separator = separators[rng.integers(len(separators))]
        pieces = text.split(separator)
        at = int(rng.integers(len(pieces)))
        match int(rng.integers(6)):
            case 0:
                data = bytearray(text or b" ")
                data[rng.integers(len(data))] = rng.integers(256)
                text = bytes(data)
                continue
            case 1:
                text = text[: rng.integers(len(text) + 1)]
                continue
            case 2:
                del pieces[at]
            case 3:
                pieces.insert(at, pieces[rng.integers(len(pieces))])
            case _:
                pieces[at] = tokens[rng.integers(len(tokens))]
        text = separator.join(pieces)
    return text


def refused(read):
    """Whether it is refused; messages of errors and warnings are short lines."""
    return checked(read) is not None


def checked(read):
    """Why it is refused, None if it is not; as `refused`."""
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        warnings.simplefilter("ignore", DeprecationWarning)
        try:
            read()
            reason = None
        except LumitreeError as error:
            reason = str(error)
    assert all(entry.category is LumitreeWarning for entry in caught), [*map(str, caught)]
    for text in [reason or "-", *(str(entry.message) for entry in caught)]:
        assert text.isprintable(), ascii(text[:300])
        assert 0 < len(text) < 1000, text[:300]
    return reason
