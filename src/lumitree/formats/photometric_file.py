"""Photometric files and ray files by their suffix: read, and as assets."""

import os
import warnings
from collections.abc import Mapping

from lumitree.asset.asset import Asset
from lumitree.core.photometry import RGB
from lumitree.errors import LumitreeWarning
from lumitree.formats.ies import read_ies
from lumitree.formats.ldt import read_ldt
from lumitree.formats.tm25 import read_tm25
from lumitree.formats.tm33 import read_tm33
from lumitree.formats.type_c import IntensityDistribution
from lumitree.lamp.source import RAY_SUFFIXES, gldf_variant, photometric_suffix
from lumitree.trace.light_field_config import LightFieldConfig

_WHITE = (1.0, 1.0, 1.0)
_READERS = {".ies": read_ies, ".ldt": read_ldt}


def read_photometry(path: str | os.PathLike[str]) -> tuple[IntensityDistribution, RGB] | None:
    """The intensities of an IES, EULUMDAT or TM-33 file, and their colour of luminance 1.

    None for GLDF files and ray files, whose light is not one distribution.
    """
    suffix = photometric_suffix(path) or ""
    if suffix == ".gldf" or suffix in RAY_SUFFIXES:
        return None
    read = _READERS.get(suffix)
    return read_tm33(path) if read is None else (read(path), _WHITE)


def read_again(path: str | os.PathLike[str]) -> IntensityDistribution | None:
    """Intensities of a file that an asset was made of before, without its warnings."""
    with warnings.catch_warnings():
        warnings.simplefilter("ignore", LumitreeWarning)
        found = read_photometry(path)
    return None if found is None else found[0]


def details_of(path: str | os.PathLike[str]) -> Mapping[str, str]:
    """Electric power, and how a photometric file states that it was made; empty for others."""
    distribution = read_again(path) if photometric_suffix(path) in _READERS else None
    if distribution is None:
        return {}
    power = {} if distribution.watts is None else {"watts": f"{distribution.watts:g}"}
    return {**power, **distribution.details}


def bake_file(path: str | os.PathLike[str], config: LightFieldConfig) -> Asset:
    """Asset of a photometric file or ray file.

    Args:
        path: file with one of `lamp.source.PHOTOMETRIC_SUFFIXES`, or a TM-33 file; a GLDF file
            with # and a variant, if it is not the first.
        config: grid of a ray file's light field. The grid of a photometric file has 64² to 512²
            bins of direction, by how steep its intensities are, and as many cells as its openings
            need.

    Raises:
        LumitreeError: the file cannot be read, or emits nothing.
    """
    # Not at the top: files are read without Mitsuba.
    from lumitree.formats.gldf import bake_gldf
    from lumitree.formats.light_field import bake_distribution, bake_rays

    suffix = photometric_suffix(path)
    if suffix == ".gldf":
        return bake_gldf(*gldf_variant(path))
    if suffix in RAY_SUFFIXES:
        return bake_rays(*read_tm25(path), config)
    found = read_photometry(path)
    assert found is not None
    return bake_distribution(*found)
