"""Images of luminaires, assets and scenes, and what they measure."""

import contextlib
import dataclasses
import os
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from lumitree.api.luminaires import dataset_folder, warn_of_faults
from lumitree.api.measures import Stopwatch
from lumitree.api.results import (
    EvaluateResult,
    Flux,
    MissedFlux,
    PreviewResult,
    RenderResult,
    asset_json,
)
from lumitree.asset.asset import Asset
from lumitree.asset.file import load
from lumitree.core.arguments import (
    check_image_settings,
    check_range,
    check_sheet_output,
)
from lumitree.core.backend import load_mitsuba
from lumitree.core.dataset import MAX_VIEWS, Dataset
from lumitree.core.files import check_writable, write_bytes
from lumitree.core.images import check_image_name, encode_png, write_image
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.seeds import check_seed
from lumitree.core.work_folder import scratch_folder
from lumitree.errors import explained

if TYPE_CHECKING:
    from lumitree.luminaire.luminaire import LuminaireLike
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.proxy import ProxyKind

FilePath = str | os.PathLike[str]
# Paths of the flux of a preview, and of its statistics of bounces.
FLUX_PATHS, BOUNCE_PATHS = 1 << 22, 1 << 20


@explained
def preview(
    luminaire: "LuminaireLike",
    sheet: FilePath | None = None,
    *,
    resolution: int = 256,
    samples_per_pixel: int = 64,
    bounces: bool = False,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> PreviewResult:
    """Look at a luminaire before it is baked: six views on a contact sheet, and its figures.

    Args:
        luminaire: as for `bake`.
        sheet: the PNG to write; None for none.
        resolution: pixels a side of each view.
        samples_per_pixel: paths.
        bounces: also measure what paths of 32, 64 and 128 bounces miss.
        variant, progress: as for `bake`.

    Raises:
        LumitreeError: bad arguments or an unreadable luminaire.
    """
    if sheet is not None:
        check_sheet_output(sheet)
    check_image_settings(resolution=resolution, spp=samples_per_pixel)
    load_mitsuba(variant)
    from lumitree.core.images import max_radiance
    from lumitree.evaluation.preview import draw_preview, take_preview
    from lumitree.luminaire.luminaire import load_luminaire
    from lumitree.transport.flux import estimate_flux, missed_by_depth

    watch = Stopwatch()
    with reporting(progress):
        with watch.stage("load"):
            lamp = load_luminaire(luminaire)
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
        sheet=None if sheet is None else Path(sheet),
        png=b"",
        **watch.costs(),
    )
    png = draw_preview(views, lamp.name, _facts(result)).png()
    if sheet is not None:
        write_bytes(sheet, png)
    return dataclasses.replace(result, png=png)


def _facts(result: PreviewResult) -> list[str]:
    """The figures on the sheet of a preview."""
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
    target: "LuminaireLike",
    sheet: FilePath | None = None,
    *,
    num_views: int = 8,
    resolution: int = 256,
    samples_per_pixel: int = 256,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> EvaluateResult:
    """Compare an asset with held-out views of its luminaire.

    Args:
        asset: an asset or its file.
        target: a luminaire, as for `bake`, of which views are captured first; or the folder of a
            dataset.
        sheet: the PNG of the contact sheet; None for none.
        num_views, resolution, samples_per_pixel: of the views that are captured.
        variant, progress: as for `bake`.

    Raises:
        LumitreeError: bad arguments, unreadable input, or views of another luminaire.
    """
    if sheet is not None:
        check_sheet_output(sheet)
    check_range("views", num_views, 1, MAX_VIEWS)
    check_image_settings(resolution=resolution, spp=samples_per_pixel)
    load_mitsuba(variant)
    from lumitree.evaluation.evaluate import evaluate_views
    from lumitree.evaluation.sheet import draw_sheet
    from lumitree.luminaire.luminaire import load_luminaire
    from lumitree.views.capture import capture as capture_views

    path = None if isinstance(asset, Asset) else asset
    baked = asset if isinstance(asset, Asset) else load(asset)
    watch = Stopwatch()
    with contextlib.ExitStack() as stack:
        stack.enter_context(reporting(progress))
        if (stored := dataset_folder(target)) is not None:
            dataset = Dataset.open(stored)
        else:
            folder = stack.enter_context(scratch_folder())
            with watch.stage("references"):
                lamp = load_luminaire(target)
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
            result = evaluate_views(baked, dataset)
            title = baked.luminaire if path is None else f"{baked.luminaire}, {path}"
            png = draw_sheet(result.rows, result.max_radiance, title).png()
            if sheet is not None:
                write_bytes(sheet, png)
    return EvaluateResult(
        metrics=result.metrics,
        max_radiance=result.max_radiance,
        views=result.views,
        asset=asset_json(baked, path),
        sheet=None if sheet is None else Path(sheet),
        png=png,
        **watch.costs(),
    )


@explained
def render(
    scene: FilePath,
    placements: "Sequence[Placement]" = (),
    output: FilePath | None = None,
    *,
    samples_per_pixel: int = 64,
    width: int | None = None,
    proxy: "ProxyKind" = "box",
    seed: int = 0,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> RenderResult:
    """Render a scene file with luminaires placed in it.

    Args:
        scene: a Mitsuba 3 scene with a camera.
        placements: luminaires, and where they go.
        output: the image to write, `.exr` (linear) or `.png` (tone-mapped); None for none.
        samples_per_pixel: of the image.
        width: of the image in pixels, instead of the scene's.
        proxy: surface that carries a baked luminaire, "box" or "sphere".
        seed: of all random numbers, 0 to 2³¹ - 1.
        variant, progress: as for `bake`.

    Raises:
        LumitreeError: bad arguments or unreadable input.
    """
    if output is not None:
        check_image_name(output)
        check_writable(output)
    check_image_settings(spp=samples_per_pixel, **({} if width is None else {"width": width}))
    check_seed(seed)
    load_mitsuba(variant)
    from lumitree.rendering.scene import (
        PlacedLuminaire,
        load_scene,
        place_luminaires,
        render_scene,
        set_film_width,
    )

    watch = Stopwatch()
    with reporting(progress):
        with watch.stage("load"):
            placed = [PlacedLuminaire(each) for each in placements]
            loaded, integrator = load_scene(str(scene), placed)
            if width is not None:
                set_film_width(loaded, width)
            whole = place_luminaires(loaded, placed, proxy)
        with watch.stage("render"):
            pixels = render_scene(whole, integrator, samples_per_pixel, seed=seed)
    if output is not None:
        write_image(output, pixels)
    return RenderResult(
        pixels=pixels,
        image=None if output is None else Path(output),
        resolution=(pixels.shape[1], pixels.shape[0]),
        samples_per_pixel=samples_per_pixel,
        mean_radiance=float(pixels.mean()),
        png=encode_png(pixels),
        **watch.costs(),
    )
