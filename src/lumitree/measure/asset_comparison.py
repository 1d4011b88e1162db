"""Comparison of two assets, of which one may be a photometric file: the irradiance around them."""

from pathlib import Path

import numpy as np

from lumitree.asset.asset import Asset
from lumitree.core.files import write_bytes
from lumitree.core.image_settings import image_settings
from lumitree.core.results import EvaluateResult, asset_json
from lumitree.core.stopwatch import Stopwatch
from lumitree.errors import LumitreeError
from lumitree.render.files import FilePath


def compare_assets(
    asset: Asset,
    path: FilePath | None,
    reference: Asset,
    sheet: Path | None,
    irradiance_paths: int,
) -> EvaluateResult:
    """As `lumitree.evaluate`, with another asset: only the irradiance is compared.

    Args:
        path: file of `asset`, if it is one.
        sheet: file to write, with the irradiance in false colour.

    Raises:
        LumitreeError: the bounding boxes have different sizes, or there are 0 paths.
    """
    from lumitree.measure.irradiance_figure import draw_irradiance
    from lumitree.measure.view_errors import evaluate_irradiance

    if irradiance_paths == 0:
        raise LumitreeError(
            f"of {reference.luminaire} there are no views, and with 0 irradiance paths nothing is "
            "compared; give more"
        )
    # The irradiance is compared around one box.
    if not np.allclose(asset.frame.size, reference.frame.size, rtol=1e-3, atol=0):
        sizes = [" x ".join(f"{side:.4g}" for side in e.frame.size) for e in (asset, reference)]
        raise LumitreeError(
            f"{asset.luminaire} has a bounding box of {sizes[0]}, and {reference.luminaire} one of "
            f"{sizes[1]}, around which the irradiance cannot be compared; compare their far "
            "fields, by `lumitree photometry` of each"
        )
    title = asset.luminaire if path is None else f"{asset.luminaire}, {path}"
    settings = image_settings("evaluate", asset=title, irradiance_paths=irradiance_paths)
    watch = Stopwatch()
    with watch.stage("irradiance"):
        found = evaluate_irradiance(asset.without_gain, reference.without_gain, irradiance_paths)
        png = draw_irradiance(found, title).png(settings)
        if sheet is not None:
            write_bytes(sheet, png)
    return EvaluateResult(
        metrics=found.metrics,
        max_radiance=None,
        views=[],
        asset=asset_json(asset, path),
        sheet=None,
        png=png,
        irradiance=found.report(),
        irradiance_sheet=sheet,
        irradiance_png=png,
        **watch.costs(),
    )
