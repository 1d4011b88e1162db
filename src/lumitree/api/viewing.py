"""Images and measurements of luminaires, assets and scenes."""

import contextlib
import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from lumitree.api.asset_comparison import compare_assets
from lumitree.api.files import FilePath, asset_of
from lumitree.api.image_settings import image_settings
from lumitree.api.irradiance import check_irradiance_paths
from lumitree.api.luminaires import dataset_folder, warn_of_faults
from lumitree.api.measures import Stopwatch
from lumitree.api.results import (
    AssetPreviewResult,
    EvaluateResult,
    Flux,
    MissedFlux,
    PreviewResult,
    asset_json,
)
from lumitree.asset.asset import Asset
from lumitree.core.arguments import (
    check_image_settings,
    check_range,
    check_sheet_output,
)
from lumitree.core.backend import load_mitsuba
from lumitree.core.dataset import MAX_VIEWS, Dataset
from lumitree.core.files import write_bytes
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.work_folder import scratch_folder
from lumitree.errors import LumitreeError, explained
from lumitree.rendering.opened import open_asset

if TYPE_CHECKING:
    from lumitree.luminaire.luminaire import LuminaireLike

# Numbers of light paths of a preview, for the flux and for the flux by number of bounces.
FLUX_PATHS, BOUNCE_PATHS = 1 << 22, 1 << 20
# Light paths, and rays of the asset, of an evaluation's irradiance: 4 to 9 s each on 2 CPU cores,
# for a standard error of about 0.5 % of the mean of a face.
IRRADIANCE_PATHS = 1 << 20


@explained
def preview(
    luminaire: "Asset | LuminaireLike",
    sheet: FilePath | None = None,
    *,
    resolution: int = 256,
    samples_per_pixel: int = 64,
    bounces: bool = False,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> PreviewResult | AssetPreviewResult:
    """Render six views of a luminaire or of an asset, and measure its flux and size.

    The contact sheet shows the radiance at two exposures and both opacities, from six sides. Warns
    of glass that Mitsuba cannot render correctly. Of an asset the sheet shows what images show
    of it, its model, its field or else its exitant light field, and one opacity.

    Args:
        luminaire: what to render: an asset, the path of a `.lumitree` file, of a photometric file
            or of a ray file; or a luminaire in any form that `bake` takes except the folder of a
            dataset.
        sheet: path of the PNG file to write. Default: no file is written.
        resolution: pixels per side of each view, 1 to 16,384.
        samples_per_pixel: paths per pixel, 1 to 1,048,576. It does not apply to an asset without
            a model, whose pixels have 16 rays.
        bounces: whether to measure the share of the flux that paths of at most 32, 64 and 128
            bounces miss. Not for an asset.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step; see `bake`.

    Returns:
        The figures of the luminaire or the asset (`AssetPreviewResult`), and the contact sheet as
        `png`. Those of a luminaire have its `shapes`, for `keep` and `drop` of `load_luminaire`.

    Raises:
        LumitreeError: an argument is out of range; the luminaire cannot be read; or the file cannot
            be written.
    """
    if sheet is not None:
        check_sheet_output(sheet)
    check_image_settings(resolution=resolution, spp=samples_per_pixel)
    mi = load_mitsuba(variant)
    if (asset := asset_of(luminaire)) is not None:
        if bounces:
            raise LumitreeError("an asset has no paths to count the bounces of; leave bounces out")
        with reporting(progress):
            return _preview_asset(asset, sheet, resolution, samples_per_pixel)
    from lumitree.core.images import max_radiance
    from lumitree.evaluation.preview import draw_preview, take_preview
    from lumitree.luminaire.luminaire import load_luminaire
    from lumitree.transport.flux import estimate_flux, missed_by_depth

    watch = Stopwatch()
    with reporting(progress):
        with watch.stage("load"):
            lamp = load_luminaire(cast(Any, luminaire))
        with watch.stage("diagnose"):
            faults = warn_of_faults(lamp)
        with watch.stage("views"):
            views = take_preview(lamp, resolution, samples_per_pixel)
        with watch.stage("flux"):
            estimate = estimate_flux(lamp, FLUX_PATHS)
        missed = []
        if bounces:
            with watch.stage("bounces"):
                missed = missed_by_depth(lamp, BOUNCE_PATHS)
    result = PreviewResult(
        luminaire=lamp.name,
        triangles=lamp.num_triangles,
        emitters=lamp.num_emitters,
        max_radiance=max_radiance([views.radiance]),
        size=tuple(lamp.size.tolist()),
        has_media=lamp.has_media,
        flux=Flux(
            watts=tuple(estimate.watts.tolist()),
            watts_error=tuple(estimate.watts_error.tolist()),
            lumens=estimate.lumens,
            lumens_error=estimate.lumens_error,
            paths=estimate.num_paths,
        ),
        paths_per_second=views.paths_per_second,
        exposure=views.exposure,
        faults=faults,
        bounces=[MissedFlux(**dataclasses.asdict(each)) for each in missed] or None,
        shapes=lamp.shapes,
        sheet=None if sheet is None else Path(sheet),
        png=b"",
        **watch.costs(),
    )
    settings = image_settings(
        "preview",
        luminaire=lamp.name,
        resolution=resolution,
        samples_per_pixel=samples_per_pixel,
        exposure=views.exposure,
        variant=mi.variant(),
    )
    png = draw_preview(views, lamp.name, _facts(result)).png(settings)
    if sheet is not None:
        write_bytes(sheet, png)
    return dataclasses.replace(result, png=png)


def _preview_asset(
    asset: Asset, sheet: FilePath | None, resolution: int, samples_per_pixel: int
) -> AssetPreviewResult:
    """As `preview`, of an asset."""
    from lumitree.evaluation.preview import draw_preview, take_asset_preview
    from lumitree.model.photometry import luminance
    from lumitree.rendering.asset_flux import asset_watts

    watch = Stopwatch()
    with watch.stage("views"):
        views = take_asset_preview(asset, resolution, samples_per_pixel)
    with watch.stage("flux"):
        watts = asset_watts(asset)
    lumens, size = float(luminance(watts)), asset.frame.size
    facts = [
        f"{' + '.join(asset.info.parts)}",
        f"shown: {asset.info.appearance}",
        f"flux {lumens:,.4g} lm",
        "size " + " x ".join(f"{side:.4g}" for side in size),
    ]
    settings = image_settings(
        "preview",
        asset=asset.luminaire,
        resolution=resolution,
        samples_per_pixel=None if asset.model is None else samples_per_pixel,
        exposure=views.exposure,
    )
    png = draw_preview(views, asset.luminaire, facts, baked=True).png(settings)
    if sheet is not None:
        write_bytes(sheet, png)
    return AssetPreviewResult(
        luminaire=asset.luminaire,
        parts=asset.info.parts,
        leaves=asset.num_leaves,
        size=tuple(size.tolist()),
        watts=tuple(watts.tolist()),
        lumens=lumens,
        exposure=views.exposure,
        sheet=None if sheet is None else Path(sheet),
        png=png,
        **watch.costs(),
    )


def _facts(result: PreviewResult) -> list[str]:
    """Lines of text for the contact sheet of a preview."""
    return [
        f"{result.triangles:,} triangles",
        f"{result.emitters} emitter" + ("" if result.emitters == 1 else "s"),
        f"L_max {result.max_radiance:.4g}",
        f"flux {result.flux}",
        "size " + " x ".join(f"{side:.4g}" for side in result.size),
        *(["media"] if result.has_media else []),
    ]


@explained
def evaluate(
    asset: Asset | FilePath,
    target: "Asset | LuminaireLike",
    sheet: FilePath | None = None,
    *,
    num_views: int = 8,
    resolution: int = 256,
    samples_per_pixel: int = 256,
    irradiance_paths: int = IRRADIANCE_PATHS,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> EvaluateResult:
    """Compare an asset with its luminaire: held-out views, and the irradiance around it.

    The irradiance is compared on the six faces of a cube of three times the size of the bounding
    box, and on a plane that touches the box from below. It is not compared for a dataset, whose
    views hold no light paths. An asset that has a gain, because it was baked with `lumens` or
    `temperature`, is compared without it. With a photometric file, or another asset, only the
    irradiance is compared.

    Args:
        asset: an asset, or the path of a `.lumitree` file, a photometric file or a ray file.
        target: the luminaire, in any form that `bake` takes, of which views are rendered first; or
            the folder of a dataset, whose views are used; or a photometric file, ray file or
            asset with the same bounding box.
        sheet: path of the PNG file of the contact sheet. The irradiance in false colour is written
            beside it, as sheet-irradiance.png for sheet.png. Default: no file is written.
        num_views: number of rendered views, 1 to 100,000. It does not apply to a dataset, nor do
            the next two.
        resolution: pixels per side of a rendered view, 1 to 16,384.
        samples_per_pixel: paths per pixel of a rendered view, 1 to 1,048,576.
        irradiance_paths: number of light paths of the luminaire, and of rays of the asset, that the
            irradiance is estimated with, up to 67,108,864. 0: it is not compared.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each view; see `bake`.

    Returns:
        The mean metrics (`metrics`), those of each view (`views`), the irradiance of each face
        (`irradiance`), and the contact sheet as `png`: without views, the irradiance.

    Raises:
        LumitreeError: an argument is out of range; the asset or the luminaire cannot be read; or
            the bounding boxes of the two have different proportions, or different sizes if both
            are assets.
    """
    irradiance_sheet = None
    if sheet is not None:
        check_sheet_output(sheet)
        irradiance_sheet = Path(sheet).with_stem(f"{Path(sheet).stem}-irradiance")
        check_sheet_output(irradiance_sheet)
    check_range("views", num_views, 1, MAX_VIEWS)
    check_irradiance_paths(irradiance_paths, IRRADIANCE_PATHS)
    check_image_settings(resolution=resolution, spp=samples_per_pixel)
    mi = load_mitsuba(variant)
    from lumitree.evaluation.evaluate import evaluate_irradiance, evaluate_views
    from lumitree.evaluation.irradiance_figure import draw_irradiance
    from lumitree.evaluation.sheet import draw_sheet
    from lumitree.luminaire.luminaire import load_luminaire
    from lumitree.views.capture import capture as capture_views

    path = None if isinstance(asset, Asset) else asset
    baked = open_asset(asset)
    title = baked.luminaire if path is None else f"{baked.luminaire}, {path}"
    if (reference := asset_of(target)) is not None:
        with reporting(progress):
            return compare_assets(baked, path, reference, irradiance_sheet, irradiance_paths)
    views = (
        {}
        if dataset_folder(target) is not None
        else {
            "num_views": num_views,
            "resolution": resolution,
            "samples_per_pixel": samples_per_pixel,
            "irradiance_paths": irradiance_paths,
        }
    )
    settings = image_settings("evaluate", asset=title, **views, variant=mi.variant())
    lamp, irradiance, irradiance_png = None, None, None
    watch = Stopwatch()
    with contextlib.ExitStack() as stack:
        stack.enter_context(reporting(progress))
        if (stored := dataset_folder(target)) is not None:
            dataset = Dataset.open(stored)
        else:
            folder = stack.enter_context(scratch_folder())
            with watch.stage("references"):
                lamp = load_luminaire(cast(Any, target))
                warn_of_faults(lamp)
                dataset = capture_views(
                    lamp,
                    folder,
                    num_views=num_views,
                    resolution=resolution,
                    samples_per_pixel=samples_per_pixel,
                    split="test",
                )
        with watch.stage("evaluate"):
            result = evaluate_views(baked.without_gain, dataset)
            png = draw_sheet(result.rows, result.max_radiance, title).png(settings)
            if sheet is not None:
                write_bytes(sheet, png)
        if lamp is not None and irradiance_paths > 0:
            with watch.stage("irradiance"):
                irradiance = evaluate_irradiance(baked.without_gain, lamp, irradiance_paths)
                irradiance_png = draw_irradiance(irradiance, title).png(settings)
                if irradiance_sheet is not None:
                    write_bytes(irradiance_sheet, irradiance_png)
    return EvaluateResult(
        metrics=result.metrics | ({} if irradiance is None else irradiance.metrics),
        max_radiance=result.max_radiance,
        views=result.views,
        asset=asset_json(baked, path),
        sheet=None if sheet is None else Path(sheet),
        png=png,
        irradiance=None if irradiance is None else irradiance.report(),
        irradiance_sheet=None if irradiance is None else irradiance_sheet,
        irradiance_png=irradiance_png,
        **watch.costs(),
    )
