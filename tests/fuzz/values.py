"""Numbers and texts at which readers may be wrong."""

import sys

import numpy as np

# Number tokens, as JSON, TOML, XML and the text formats write them; some are none of these.
NUMBERS = (
    *("0", "-0.0", "1", "-1", "2", "3", "7", "90", "180", "255", "256", "360", "361", "1000"),
    *("0.5", "1e-7", "1e-30", "1e-46", "5e-324", "1e7", "1e15", "1e16", "1e30", "3.5e38", "1e300"),
    *("1e308", "-1e308", "1e309", "-1e999", "2147483647", "2147483648", "-2147483649"),
    *("4294967296", "9223372036854775807", "9223372036854775808", "-9223372036854775809"),
    *("1e18", "16777217", "65535", "65536", "1048577", "134217729", "268435457", "9" * 30),
    *("NaN", "nan", "-nan", "inf", "Infinity", "-Infinity", "1_000", "0x10", "1,5", "+1", ".5"),
    *("1.", "1e", "--1", "", "٣", "\uff11", "1d5", "1.5.2", "1" * 400, "1" * 5000, "0" * 5000),
)  # fmt: skip
TEXTS = (
    *("", " ", "x", "\0", "\n", "\r\n", "\t", "\x1b[2J", "a\nb", "\ud800", "\udcff", "é", "☀"),
    *("\u2028", "\ufeff", "\u202e", "../../etc/passwd", "/dev/zero", "/dev/stdin"),
    *("..", ".", "/", "\\", "C:\\x.png", "http://a/b.png", "file:///etc/passwd", "%00", "%2e%2e"),
    *("a" * 300, "a" * 5000, "é" * 1000, "\x1b" * 3000, "&#0;", "&lt;", "<a>", "]]>", "{}", "[]"),
    *("None", "null", "NaN", "0", "-1", "1e999", "*", "?", "#", "#1", "$(id)", "%s%n", "{0}"),
)  # fmt: skip
# Changes of a number that stays a number.
_FACTORS = (-1.0, 0.0, 0.5, 2.0, 1 + 1e-7, 1e3, 1e-3, 1e10, 1e-10, 1e20)


def pick(rng, items):
    """One of some items."""
    return items[int(rng.integers(len(items)))]


def chance(rng, probability):
    """True with a probability."""
    return bool(rng.random() < probability)


def number_near(rng, value):
    """A number that was made of another one."""
    kind = int(rng.integers(4))
    if kind == 0:
        return value + int(rng.integers(-2, 3))
    if kind == 1 and isinstance(value, float):
        return float(np.nextafter(value, pick(rng, (-np.inf, np.inf))))
    try:
        changed = value * pick(rng, _FACTORS)
    except OverflowError:
        return value
    whole = isinstance(value, int) and abs(changed) < sys.float_info.max
    return int(changed) if whole else changed


def token(rng, word=None):
    """A number token; often near the number that a word is."""
    if word is not None and chance(rng, 0.4):
        try:
            value = float(word)
        except ValueError:
            return pick(rng, NUMBERS)
        return f"{number_near(rng, value):.9g}"
    return pick(rng, NUMBERS)


def text(rng):
    """A text at which readers may be wrong."""
    return pick(rng, TEXTS)
