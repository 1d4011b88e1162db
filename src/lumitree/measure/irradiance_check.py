"""The irradiance error that every bake states."""

from typing import TYPE_CHECKING

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_count
from lumitree.core.results import Json
from lumitree.core.stopwatch import Stopwatch

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire

# More would need more than some gigabytes of memory.
MAX_IRRADIANCE_PATHS = 1 << 26


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
        found = evaluate_irradiance(asset.without_gain, luminaire, num_paths)
        return found.metrics | found.report() | {"flux": check_flux(luminaire, found.explicit)}
