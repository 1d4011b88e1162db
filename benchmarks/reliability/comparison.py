"""Whether a file that a killed command left, or its continuation wrote, is that of another run."""

import json
import re
from pathlib import Path

import numpy as np
from PIL import Image

from lumitree.core.images import read_exr

# Of values that threads add in any order: relative to the largest of an image, or to each number.
TOLERANCE = 1e-3
_NUMBER = re.compile(rb"[-+]?\d+\.?\d*(?:[eE][-+]?\d+)?")


def equal(path: Path, other: Path) -> str | None:
    """How the content of two files agrees.

    Returns:
        "bytes"; "values", if images or the numbers of text agree up to `TOLERANCE`; or None.
    """
    if path.read_bytes() == other.read_bytes():
        return "bytes"
    close = {".exr": _close_exr, ".png": _close_png}.get(path.suffix, _close_text)
    try:
        return "values" if close(path, other) else None
    except Exception:
        return None


def is_complete(path: Path) -> bool:
    """Whether a file whose content has times or paths is whole."""
    content = path.read_bytes()
    if path.suffix == ".json":
        try:
            json.loads(content)
        except ValueError:
            return False
        return True
    if path.suffix == ".html":
        return content.rstrip().endswith(b"</html>")
    return bool(content)


def _close_exr(path: Path, other: Path) -> bool:
    planes, others = read_exr(path), read_exr(other)
    return planes.keys() == others.keys() and all(
        plane.shape == others[name].shape
        and np.allclose(plane, others[name], rtol=0, atol=TOLERANCE * np.abs(plane).max())
        for name, plane in planes.items()
    )


def _close_png(path: Path, other: Path) -> bool:
    pixels, others = (np.asarray(Image.open(each)).astype(int) for each in (path, other))
    return pixels.shape == others.shape and np.abs(pixels - others).max() <= 1


def _close_text(path: Path, other: Path) -> bool:
    texts = [each.read_bytes() for each in (path, other)]
    # Of binary files any difference counts.
    if any(b"\0" in text for text in texts):
        return False
    words = [_NUMBER.sub(b"0", text) for text in texts]
    numbers = [np.array(_NUMBER.findall(text), float) for text in texts]
    return words[0] == words[1] and np.allclose(*numbers, rtol=TOLERANCE, atol=1e-9)
