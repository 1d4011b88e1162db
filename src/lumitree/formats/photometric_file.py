"""Photometric files, by their suffix."""

import os
import warnings
from collections.abc import Mapping
from pathlib import Path

from lumitree.errors import LumitreeWarning
from lumitree.formats.ies import read_ies
from lumitree.formats.ldt import read_ldt
from lumitree.formats.type_c import IntensityDistribution

_READERS = {".ies": read_ies, ".ldt": read_ldt}


def read_distribution(path: str | os.PathLike[str]) -> IntensityDistribution | None:
    """The intensities of an IES or EULUMDAT file; None for a file of another suffix.

    Raises:
        LumitreeError: as of `read_ies` and `read_ldt`.
    """
    read = _READERS.get(Path(path).suffix.lower())
    return None if read is None else read(path)


def read_again(path: str | os.PathLike[str]) -> IntensityDistribution | None:
    """As `read_distribution`, without the warnings of a file that an asset was made of before."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LumitreeWarning)
        return read_distribution(path)


def details_of(path: str | os.PathLike[str]) -> Mapping[str, str]:
    """What a photometric file states of how it was made; empty for other files."""
    distribution = read_again(path)
    return {} if distribution is None else distribution.details
