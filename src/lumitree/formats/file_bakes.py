"""Assets of photometric files and ray files, by the kind of file."""

import os

from lumitree.asset.asset import Asset
from lumitree.formats.gldf_asset import bake_gldf
from lumitree.formats.light_field import bake_distribution, bake_rays
from lumitree.formats.photometric_file import read_photometry
from lumitree.formats.tm25 import read_tm25
from lumitree.lamp.source import RAY_SUFFIXES, gldf_variant, photometric_suffix
from lumitree.trace.light_field_config import LightFieldConfig


def bake_file(path: str | os.PathLike[str], config: LightFieldConfig) -> Asset:
    """Asset of a photometric file or ray file.

    Args:
        path: file with one of `lamp.source.PHOTOMETRIC_SUFFIXES`, or a TM-33 file; of a GLDF file
            with # and a variant, if it is not the first.
        config: grid of a ray file's light field. That of a photometric file has 64² to 512² bins of
            direction, by how steep its intensities are, and as many cells as its openings need.

    Raises:
        LumitreeError: the file cannot be read, or emits nothing.
    """
    suffix = photometric_suffix(path)
    if suffix == ".gldf":
        return bake_gldf(*gldf_variant(path))
    if suffix in RAY_SUFFIXES:
        return bake_rays(*read_tm25(path), config)
    found = read_photometry(path)
    assert found is not None
    return bake_distribution(*found)
