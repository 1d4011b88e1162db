"""IES and EULUMDAT files that are made of random parts, most of which fit together."""

import numpy as np

from fuzz.values import chance, pick, text, token

_HEADS = (
    *("IESNA:LM-63-2002", "IESNA:LM-63-1995", "IESNA91", "IES:LM-63-2019", "IESNA:LM-63-1986", ""),
    *("IESNA86", "IES LM_63/99", "iesna:lm-63-02"),
)
_KEYWORDS = ("[LUMINAIRE] A lamp", "[MORE] more", "[TEST] 1", "[MANUFAC] x", "[BLOCK]", "no key")
# Last planes and first planes of files, by their symmetries.
_PLANES = ((0, 0), (0, 90), (0, 180), (180, 360), (90, 270), (0, 360), (0, 345), (-90, 90))
_ANGLES = ((0, 90), (0, 180), (90, 180), (0, 45))
# Of Types A and B.
_HALVES = ((-90, 90), (0, 90), (-90, 0), (-60, 60))
_SIGNED = (0.0, 0.1, -0.1, 0.3, -0.3, 1e-7, -25.0)
# Most files are small, so that many are read in a second.
_FEW, _SOME = 6, 25


def _angles(rng, ends, most):
    """Ascending angles of one of several ranges, sometimes uneven."""
    low, high = pick(rng, ends)
    if low == high:
        return [float(low)]
    angles = np.linspace(low, high, int(rng.integers(2, most)))
    if chance(rng, 0.2) and len(angles) > 2:
        angles[1:-1] += rng.uniform(-0.4, 0.4, len(angles) - 2) * (angles[1] - angles[0])
    return angles.tolist()


def _intensities(rng, count):
    values = 100 * rng.random(count)
    if chance(rng, 0.1):
        values -= pick(rng, (0.01, 1.0, 50.0))
    if chance(rng, 0.1):
        values *= pick(rng, (0.0, 1e-12, 1e12, 1e15))
    return values.tolist()


def _spoiled(rng, numbers, share):
    """Words of numbers, one of which is often wrong."""
    words = [f"{number:.7g}" for number in numbers]
    if words and chance(rng, share):
        at = int(rng.integers(len(words)))
        words[at] = token(rng, words[at])
    return words


def ies(rng):
    """Text of an IES file, whose counts agree with what follows, most of the time."""
    most = _SOME if chance(rng, 0.1) else _FEW
    kind = pick(rng, (1, 1, 1, 2, 3))
    fitting = (_ANGLES, _PLANES) if (kind == 1) != chance(rng, 0.05) else (_HALVES, _HALVES)
    vertical, horizontal = (_angles(rng, each, most) for each in fitting)
    values = _intensities(rng, len(vertical) * len(horizontal))
    head = [pick(rng, _HEADS), *(pick(rng, _KEYWORDS) for _ in range(int(rng.integers(4))))]
    if chance(rng, 0.05):
        head.insert(int(rng.integers(len(head) + 1)), f"[LUMINAIRE] {text(rng)}")
    header = [
        *(1, pick(rng, (-1, 1000)), pick(rng, (1, 1, 2.5)), len(vertical), len(horizontal)),
        *(kind, pick(rng, (1, 2)), *(pick(rng, _SIGNED) for _ in range(3))),
        *(pick(rng, (1, 1, 0.9)), pick(rng, ("1", "1", "1.00010", "1.5", "0.95", "0")), 50),
    ]
    words = [str(each) for each in header]
    if chance(rng, 0.3):
        at = int(rng.integers(len(words)))
        words[at] = token(rng, words[at])
    rows = [words[:10], words[10:], _spoiled(rng, vertical, 0.1), _spoiled(rng, horizontal, 0.1)]
    rows.append(_spoiled(rng, values, 0.1))
    separator = pick(rng, (" ", " ", " ", ",", ", ", "\n"))
    body = "\n".join(separator.join(row) for row in rows)
    if chance(rng, 0.05):
        body = body.replace(".", ",")
    text_of_all = "\n".join([*head, *_tilt(rng), body, ""])
    newline = pick(rng, ("\n", "\n", "\n", "\r\n", "\r", "\r\r\n"))
    return _encoded(rng, text_of_all.replace("\n", newline))


def _tilt(rng):
    if chance(rng, 0.75):
        return [pick(rng, ("TILT=NONE", "TILT=NONE", "TILT = none", "TILT=", "  tilt=<NONE>"))]
    if chance(rng, 0.3):
        return [f"TILT={pick(rng, ('tilt.tlt', 'TILT.TLT', 'no.tlt', text(rng)))}"]
    return ["TILT=INCLUDE", tilt(rng)]


def tilt(rng):
    """The table of a TILT file."""
    angles = _angles(rng, _ANGLES, _FEW)
    factors = rng.random(len(angles)).tolist()
    count = str(len(angles)) if chance(rng, 0.8) else token(rng, str(len(angles)))
    rows = ["1", count, " ".join(_spoiled(rng, angles, 0.2)), " ".join(_spoiled(rng, factors, 0.2))]
    return "\n".join(rows)


def ldt(rng):
    """Text of an EULUMDAT file, whose counts agree with what follows, most of the time."""
    symmetry = int(rng.integers(5))
    planes = 4 * int(rng.integers(1, 7)) if symmetry else int(rng.integers(1, 9))
    gamma = _angles(rng, _ANGLES[:2], _SOME if chance(rng, 0.1) else _FEW)
    held = {0: planes, 1: 1, 2: planes // 2 + 1, 3: planes // 2 + 1, 4: planes // 4 + 1}[symmetry]
    sets = pick(rng, (1, 1, 1, 2, 3))
    named = pick(rng, (planes, planes, held))
    sizes = [pick(rng, (0, 100, 600, -5, 1e-4)) for _ in range(9)]
    lines = ["company", 1, symmetry, planes, 360 / planes, len(gamma), 5, "report", "lamp", "no"]
    lines += ["file", "date", *sizes, 100, pick(rng, (100, 80, 0)), pick(rng, (1, 0, 2.5)), 0, sets]
    for _ in range(sets):
        lines += [pick(rng, (1, 1, -1)), "LED", pick(rng, (500, 1000)), "3000", "80", 10]
    lines += [0.5] * 10
    step = 360 / planes
    lines += [f"{step * plane:.7g}" for plane in range(named)]
    lines += [f"{angle:.7g}" for angle in gamma]
    lines += [f"{value:.7g}" for value in _intensities(rng, held * len(gamma))]
    words = [str(each) for each in lines]
    for _ in range(pick(rng, (0, 0, 1, 1, 2))):
        at = int(rng.integers(36 if chance(rng, 0.7) else len(words)))
        words[at] = text(rng) if chance(rng, 0.1) else token(rng, words[at])
    return _encoded(rng, "\n".join(words) + "\n")


def _encoded(rng, whole):
    encoding = pick(rng, ("utf-8",) * 6 + ("latin-1", "utf-16", "utf-16-le", "utf-8-sig"))
    if encoding == "utf-8":
        return whole.encode("utf-8", "surrogatepass")
    return whole.encode(encoding, "replace")
