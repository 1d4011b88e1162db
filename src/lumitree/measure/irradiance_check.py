"""The irradiance error that every bake states."""

import warnings
from typing import TYPE_CHECKING

import numpy as np

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField
from lumitree.core.arguments import check_count
from lumitree.core.results import Json, Stopwatch
from lumitree.errors import LumitreeWarning

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire
    from lumitree.measure.irradiance import IrradianceError

# More would need more than some gigabytes of memory.
MAX_IRRADIANCE_PATHS = 1 << 26
# Light fields have RMS errors of a few percent. Above this there is a cause, and a warning.
_LARGEST_RMS = 0.1
# Fewer cells than this are few. Light is in a far part of its box if the mean place of the cells is
# farther from the middle, local units.
_FEW_CELLS, _FAR = 20, 0.5


def check_irradiance_paths(paths: int) -> None:
    """Refuse a number of paths that is not from 0 to `MAX_IRRADIANCE_PATHS`."""
    check_count("irradiance_paths", paths, 0, MAX_IRRADIANCE_PATHS)


def measure_irradiance(
    asset: Asset, luminaire: "Luminaire", num_paths: int, watch: Stopwatch
) -> Json | None:
    """Compare the irradiance around an asset, without its gain, with that around its luminaire.

    Args:
        num_paths: light paths of the luminaire, and rays of the asset. 0: it is not compared.
        watch: measures the stage "irradiance".

    Returns:
        `irradiance` of a `BakeResult`; None if it was not compared.
    """
    if num_paths == 0:
        return None
    from lumitree.measure.flux_check import check_flux
    from lumitree.measure.irradiance import evaluate_irradiance

    with watch.stage("irradiance"):
        found = evaluate_irradiance(asset.without_factors, luminaire, num_paths)
        if asset.light_field is not None:
            _warn_of_error(found.error, asset.light_field, asset.luminaire)
        return found.metrics | found.report() | {"flux": check_flux(luminaire, found.explicit)}


def _warn_of_error(error: "IrradianceError", field: LightField, name: str) -> None:
    """Warn of an RMS error above `_LARGEST_RMS` that is not noise, with its likely cause."""
    if not error.mean_rms - np.nanmean(error.rms_error) > _LARGEST_RMS:
        return
    middle = (field.cells.mean(axis=0) + 0.5) / (1 << field.depth) * 2 - 1
    if np.abs(middle).max() > _FAR:
        cause = "its light starts in one far part of its box; leave out what makes the box large"
    elif len(field.cells) < _FEW_CELLS:
        cause = (
            f"its light starts in only {len(field.cells)} cells; bake it with a larger "
            "LightFieldConfig.depth"
        )
    else:
        cause = (
            "look for a material that makes narrow beams, such as smooth metal or glass in place "
            "of rough"
        )
    warnings.warn(
        f"the irradiance around {name} has an RMS error of {error.mean_rms:.0%}, expected at most "
        f"{_LARGEST_RMS:.0%}: {cause}",
        LumitreeWarning,
        stacklevel=3,
    )
