"""Comparison of an asset with its luminaire: held-out views, and the irradiance around it."""

import contextlib
import dataclasses
import math
import time as clocks
from collections.abc import Callable
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.arguments import (
    MAX_SAMPLES,
    check_count,
    check_image_settings,
    check_range,
    check_sheet_output,
)
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.files import FilePath, scratch_folder, write_bytes
from lumitree.core.frames import LocalFrame
from lumitree.core.images import image_settings
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.progress import progress as progress_of
from lumitree.core.results import ImageResult, Json, Stopwatch
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.dataset import MAX_VIEWS, Dataset, Frame, OpacityKind
from lumitree.lamp.diagnosis import warn_of_faults
from lumitree.lamp.source import dataset_folder
from lumitree.measure.irradiance import check_flux, check_irradiance_paths, evaluate_irradiance
from lumitree.rendering.asset_cache import asset_json, asset_of, open_asset

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire, LuminaireLike
    from lumitree.measure.figures import SheetRow

Predict = Callable[[Frame], tuple[NDArray[np.floating], NDArray[np.floating]]]

# Light paths, and rays of the asset, of an evaluation's irradiance: a few seconds of processor time
# for both, for a standard error of 0.3 to 1 % of the mean of a face.
IRRADIANCE_PATHS = 1 << 19
# Processor time of the paths of all views, s, and most samples per pixel, if neither samples nor a
# time is given. The rest of an evaluation takes 10 to 15 s of processor time.
_PROCESSOR_SECONDS, _SAMPLES_PER_PIXEL = 8.0, 256
# Samples per pixel of the images that the time of a sample is measured with; the first compiles.
_MEASURED = (1, 16)


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class EvaluateResult(ImageResult):
    """Comparison of an asset with its luminaire: views, and the irradiance around it.

    Attributes:
        metrics: metrics by name, as means over the views; the gains over black, in dB, are
            `gain_linear` and `gain_mulaw`. If the irradiance was compared, also `irradiance_ratio`:
            flux through a cube of three times the luminaire's size, baked over explicit;
            `irradiance_rms`: relative RMS error of the irradiance, mean over the cube's six faces;
            and `irradiance_rms_touching`: the same on a plane that touches the bounding box from
            below. A metric whose reference is too noisy, or dark, is omitted.
        max_radiance: L_max of the views, W/(m² sr), by which the metrics divide radiance; None
            without views: the asset was compared with another asset.
        spp: paths per pixel of the views; None without views.
        views: metrics by name, of each view.
        asset: `Asset.info` as a dictionary, and file and size in bytes if the asset is a file.
        sheet: file of the contact sheet; None if none was written.
        irradiance: `paths`, traced for each of both sides; `ratio_error`, the standard error of
            `irradiance_ratio`; and `faces`: for each of "-x", "+x", "-y", "+y", "-z", "+z" and
            "touching" the mean illuminance `explicit_lux` and `baked_lux`, lx, their `ratio` and
            the relative `rms` error, with the standard errors `ratio_error` and `rms_error`; and
            `flux` of a luminaire by two independent methods, lm: by `light_paths`, and by
            `camera_paths` that hit its emitters, with `light_paths_error` and
            `camera_paths_error`. None if the irradiance was not compared.
        irradiance_sheet: file of the irradiance in false colour; None if none was written.
        irradiance_png: this image, as the bytes of a PNG file; None if it was not made.
    """

    metrics: dict[str, float]
    max_radiance: float | None
    spp: int | None
    views: list[Json]
    asset: Json
    sheet: Path | None
    irradiance: Json | None = None
    irradiance_sheet: Path | None = None
    irradiance_png: bytes | None = dataclasses.field(default=None, repr=False)


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Metrics of an asset on the views of a dataset.

    Attributes:
        max_radiance: L_max of the dataset's views, W/(m² sr).
        metrics: means over the views, `flux_error`, and the gains over black, by name.
        views: metrics of each view, with its `halton_index`.
        rows: images for a contact sheet.
    """

    max_radiance: float
    metrics: dict[str, float]
    views: list[Json]
    rows: "list[SheetRow]"


@in_turn
def evaluate(
    asset: Asset | FilePath,
    target: "Asset | LuminaireLike",
    output: FilePath | None = None,
    *,
    views: int = 8,
    resolution: int = 192,
    spp: int | None = None,
    time: float | None = None,
    irradiance_paths: int = IRRADIANCE_PATHS,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> EvaluateResult:
    """Compare an asset with its luminaire: held-out views, and the irradiance around it.

    The views show the radiance field of the asset; without a field its geometry, rendered with as
    many paths per pixel, so that most of the difference is the noise of both: more paths give a
    higher PSNR.

    The irradiance is compared on the six faces of a cube of three times the size of the bounding
    box, and on a plane that touches the box from below. It is not compared for a dataset, which has
    no light paths. The factors on the light of an asset that was baked with `lumens` or
    `temperature` are left out. With a photometric file, or another asset, only the irradiance is
    compared.

    Args:
        asset: an asset, or the path of a `.lumitree` file, a photometric file or a ray file.
        target: the luminaire, in any form that `bake` takes, of which views are rendered first; or
            the folder of a dataset, whose views are used; or a photometric file, ray file or
            asset with the same bounding box.
        output: path of the PNG file of the contact sheet. The irradiance in false colour is written
            beside it, as sheet-irradiance.png for sheet.png. Default: no file is written.
        views: number of rendered views, 1 to 100,000. It does not apply to a dataset, nor do
            the next three.
        resolution: pixels per side of a rendered view, 1 to 16,384.
        spp: paths per pixel of a rendered view, 1 to 1,048,576. Default: the power of
            two that the time allows, which is measured first.
        time: time of the paths of all views, s, 0.001 to 10⁷. Default: none if there are
            `spp`; else 8 s of processor time (of all cores together), for at most
            256 paths per pixel. All else takes about as long.
        irradiance_paths: number of light paths of the luminaire, and of rays of the asset, that the
            irradiance is estimated with, up to 67,108,864. 0: it is not compared.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each view; see `bake`.

    Returns:
        The mean metrics (`metrics`), the metrics of each view (`views`), the irradiance of each
        face (`irradiance`), and the contact sheet as `png`: without views, the irradiance.

    Raises:
        LumitreeError: an argument is out of range; the asset or the luminaire cannot be read; or
            the bounding boxes of the two have different proportions, or different sizes if both
            are assets.
    """
    irradiance_sheet = None
    if output is not None:
        check_sheet_output(output)
        irradiance_sheet = Path(output).with_stem(f"{Path(output).stem}-irradiance")
        check_sheet_output(irradiance_sheet)
    check_count("views", views, 1, MAX_VIEWS)
    check_irradiance_paths(irradiance_paths)
    check_image_settings(resolution=resolution, spp=spp or 1)
    if time is not None:
        check_range("time", time, 1e-3, 1e7)
    mi = load_rgb(variant)
    from lumitree.measure.figures import draw_irradiance, draw_sheet

    path = None if isinstance(asset, Asset) else asset
    baked = open_asset(asset)
    title = baked.luminaire if path is None else f"{baked.luminaire}, {path}"
    if (reference := asset_of(target)) is not None:
        with reporting(progress):
            return _compare_assets(baked, path, reference, irradiance_sheet, irradiance_paths)
    irradiance, irradiance_png, flux = None, None, {}
    watch = Stopwatch()
    with contextlib.ExitStack() as stack:
        stack.enter_context(reporting(progress))
        sizes = (views, resolution, spp)
        lamp, dataset = _references(cast(Any, target), baked, watch, stack, sizes, time)
        samples = dataset.manifest.spp
        budget: Json = {"views": views, "resolution": resolution, "spp": samples}
        budget = {} if lamp is None else {**budget, "irradiance_paths": irradiance_paths}
        settings = image_settings("evaluate", asset=title, **budget, variant=mi.variant())
        with watch.stage("evaluate"):
            result = evaluate_views(baked.without_factors, dataset)
            png = draw_sheet(result.rows, result.max_radiance, title).png(settings)
            if output is not None:
                write_bytes(output, png)
        if lamp is not None and irradiance_paths > 0:
            with watch.stage("irradiance"):
                irradiance = evaluate_irradiance(baked.without_factors, lamp, irradiance_paths)
                flux = {"flux": check_flux(lamp, irradiance.explicit)}
                irradiance_png = draw_irradiance(irradiance, title).png(settings)
                if irradiance_sheet is not None:
                    write_bytes(irradiance_sheet, irradiance_png)
    return EvaluateResult(
        metrics=result.metrics | ({} if irradiance is None else irradiance.metrics),
        max_radiance=result.max_radiance,
        spp=samples,
        views=result.views,
        asset=asset_json(baked, path),
        sheet=None if output is None else Path(output),
        png=png,
        irradiance=None if irradiance is None else irradiance.report() | flux,
        irradiance_sheet=None if irradiance is None else irradiance_sheet,
        irradiance_png=irradiance_png,
        **watch.costs(),
    )


def _references(
    target: "LuminaireLike",
    asset: Asset,
    watch: Stopwatch,
    stack: contextlib.ExitStack,
    sizes: tuple[int, int, int | None],
    time: float | None,
) -> tuple["Luminaire | None", Dataset]:
    """The views of a dataset; or a luminaire and new views of it, whose folder `stack` removes.

    `sizes`: number, resolution and samples per pixel of new views.
    """
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.trace.cameras import capture

    if (stored := dataset_folder(target)) is not None:
        return None, Dataset.open(stored)
    folder = stack.enter_context(scratch_folder())
    count, resolution, samples = sizes
    with watch.stage("references"):
        lamp = load_luminaire(target)
        _check_proportions(asset, lamp.frame, lamp.name)
        warn_of_faults(lamp)
        if samples is None or time is not None:
            # The geometry of the asset is rendered with as many paths.
            pixels = count * resolution**2 * (1 if asset.num_leaves or not asset.geometry else 2)
            samples = min(samples or MAX_SAMPLES, _samples_in(time, lamp, resolution, pixels))
        dataset = capture(
            lamp,
            folder,
            views=count,
            resolution=resolution,
            spp=samples,
            split="test",
        )
    return lamp, dataset


def _samples_in(time: float | None, lamp: "Luminaire", resolution: int, pixels: int) -> int:
    """Paths per pixel, a power of two, that a time allows for all `pixels` of all images."""
    from lumitree.core.frames import FIRST_TEST_INDEX, view_pose
    from lumitree.core.seeds import Purpose, SeedStream
    from lumitree.trace.cameras import Camera

    if time is None:
        clock, limit, most = clocks.process_time, _PROCESSOR_SECONDS, _SAMPLES_PER_PIXEL
    else:
        clock, limit, most = clocks.monotonic, time, MAX_SAMPLES
    pose = view_pose(FIRST_TEST_INDEX, 2 * lamp.bounding_radius)
    spent = []
    for samples in _MEASURED:
        start = clock()
        Camera(lamp, resolution, samples).take(pose, SeedStream(Purpose.CAPTURE, FIRST_TEST_INDEX))
        spent.append(clock() - start)
    # With the constant time of an image: a difference of two times is noisy on a busy machine.
    of_sample = spent[-1] / _MEASURED[-1] / resolution**2
    affordable = limit / max(of_sample * pixels, limit / most)
    return 1 << max(0, math.floor(math.log2(affordable)))


def _compare_assets(
    asset: Asset,
    path: FilePath | None,
    reference: Asset,
    sheet: Path | None,
    irradiance_paths: int,
) -> EvaluateResult:
    """As `evaluate`, with another asset: only the irradiance is compared.

    Raises:
        LumitreeError: the bounding boxes have different sizes, or there are 0 paths.
    """
    from lumitree.measure.figures import draw_irradiance

    if irradiance_paths == 0:
        raise LumitreeError(
            f"an asset such as {reference.luminaire} has no views, and with 0 irradiance paths "
            "nothing is compared; give more"
        )
    # The irradiance is compared around one box.
    if not np.allclose(asset.frame.size, reference.frame.size, rtol=1e-3, atol=0):
        sizes = [" x ".join(f"{side:.4g}" for side in e.frame.size) for e in (asset, reference)]
        raise LumitreeError(
            f"the assets of {asset.luminaire} and {reference.luminaire} have bounding boxes of "
            f"{sizes[0]} and {sizes[1]}, around which the irradiance cannot be compared; compare "
            "their far fields, by `lumitree photometry` of each"
        )
    title = asset.luminaire if path is None else f"{asset.luminaire}, {path}"
    settings = image_settings("evaluate", asset=title, irradiance_paths=irradiance_paths)
    watch = Stopwatch()
    with watch.stage("irradiance"):
        found = evaluate_irradiance(
            asset.without_factors, reference.without_factors, irradiance_paths
        )
        png = draw_irradiance(found, title).png(settings)
        if sheet is not None:
            write_bytes(sheet, png)
    return EvaluateResult(
        metrics=found.metrics,
        max_radiance=None,
        spp=None,
        views=[],
        asset=asset_json(asset, path),
        sheet=None,
        png=png,
        irradiance=found.report(),
        irradiance_sheet=sheet,
        irradiance_png=png,
        **watch.costs(),
    )


def _check_proportions(asset: Asset, frame: LocalFrame, name: str) -> None:
    """Refuse a luminaire whose bounding box has other proportions than an asset's."""
    if np.abs(asset.frame.half_extents - frame.half_extents).max() > 1e-3:
        raise LumitreeError(
            f"the asset ({shown(asset.luminaire, 200)}) and {shown(name, 200)} have bounding "
            "boxes of different proportions; evaluate an asset on its own luminaire"
        )


def evaluate_views(asset: Asset, dataset: Dataset) -> Evaluation:
    """Compare an asset with every view of `dataset`.

    The radiance field is compared; without a field the geometry, by as many paths a pixel as the
    views have, and its `geometric` opacity; or else the light field.

    Raises:
        LumitreeError: the dataset shows a luminaire of other proportions, or nothing.
    """
    from lumitree.rendering.asset_images import baked_view, geometry_camera

    manifest = dataset.manifest
    _check_proportions(asset, manifest.local_frame, manifest.luminaire)
    if asset.num_leaves or asset.geometry is None:
        return compare_views(lambda frame: baked_view(asset, manifest, frame), dataset)
    camera = geometry_camera(asset, manifest.half_width, manifest.resolution)
    samples = manifest.spp
    return compare_views(
        lambda frame: camera.take(frame.pose, samples, frame.halton_index, "view"),
        dataset,
        "geometric",
    )


def compare_views(
    predict: Predict, dataset: Dataset, opacity_kind: OpacityKind = "straight_through"
) -> Evaluation:
    """Compare images with every view of `dataset`.

    Args:
        predict: returns radiance [H, W, 3] and opacity [H, W] of a view.
        opacity_kind: the opacity that is compared. Default: the opacity of a field, by which the
            renderer attenuates the light behind the luminaire.

    Raises:
        LumitreeError: the dataset shows nothing.
    """
    from lumitree.measure.figures import MAX_ROWS, SheetRow
    from lumitree.measure.metrics import flux_error, gain_over_black, mean_metrics, view_metrics

    # L_max of the views, not of the asset, so that all assets are compared on one scale.
    max_radiance = dataset.max_radiance(dataset.views())
    views, rows = [], []
    with progress_of("evaluate", len(dataset.manifest.frames)) as advance:
        for view in dataset.views():
            radiance, opacity = predict(view.frame)
            expected = view.opacity(opacity_kind)
            metrics = view_metrics(radiance, view.radiance, opacity, expected, max_radiance)
            views.append({"halton_index": view.frame.halton_index, **metrics})
            name = f"view {view.frame.halton_index}"
            rows.append(SheetRow(name, view.radiance, radiance, expected, opacity, metrics))
            advance(1)
    metrics = mean_metrics([row.metrics for row in rows])
    metrics["flux_error"] = flux_error([row.baked for row in rows], [row.reference for row in rows])
    metrics |= gain_over_black(metrics)
    return Evaluation(max_radiance, metrics, views, rows[:MAX_ROWS])
