"""Preview of a luminaire before it is baked, or of an asset."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

from lumitree.asset.asset import Asset
from lumitree.core.arguments import (
    check_image_settings,
    check_sheet_output,
)
from lumitree.core.backend import load_rgb
from lumitree.core.files import FilePath, write_bytes
from lumitree.core.image_settings import image_settings
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.results import ImageResult
from lumitree.core.stopwatch import Stopwatch
from lumitree.core.turns import in_turn
from lumitree.errors import LumitreeError
from lumitree.lamp.diagnosis import warn_of_faults
from lumitree.lamp.scene_shapes import SceneShape
from lumitree.rendering.asset_cache import asset_of
from lumitree.trace.flux_figures import Flux, MissedFlux

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import LuminaireLike


# Numbers of light paths of a preview, for the flux and for the flux by number of bounces.
FLUX_PATHS, BOUNCE_PATHS = 1 << 22, 1 << 20


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class PreviewResult(ImageResult):
    """Figures of a luminaire, and its views from six sides.

    Attributes:
        luminaire: name of the luminaire.
        triangles: number of triangles of its meshes.
        emitters: number of shapes that emit.
        max_radiance: L_max, the 99.99th percentile over the pixels of the views, W/(m² sr).
        size: [3] sides of the bounding box, in the unit of the luminaire's file.
        has_media: whether there are participating media.
        flux: flux that leaves the luminaire.
        paths_per_second: speed of path tracing.
        exposure: factor on the radiance in the first row of the contact sheet.
        faults: one line for each fault that cannot be rendered correctly, such as a dielectric that
            is not closed.
        bounces: share of the flux that short paths miss; None if it was not measured.
        sheet: file of the contact sheet; None if none was written.
        shapes: its shapes, with `number`, `name` (id), and `materials` (ids of BSDFs, names of
            materials), by which `keep` and `drop` find them; and with their plugins, `kind`, `bsdf`
            and `emitter`.
    """

    luminaire: str
    triangles: int
    emitters: int
    max_radiance: float
    size: tuple[float, ...]
    has_media: bool
    flux: Flux
    paths_per_second: float
    exposure: float
    faults: list[str]
    sheet: Path | None
    bounces: list[MissedFlux] | None = None
    shapes: tuple[SceneShape, ...] = ()


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class AssetPreviewResult(ImageResult):
    """Figures of an asset, and its views from six sides.

    Attributes:
        luminaire: name of the luminaire.
        parts: which of "light", "field" and "geometry" it has.
        leaves: number of leaves of its field.
        size: [3] sides of the bounding box, in the unit of the luminaire's file.
        watts: [3] flux that it emits, R, G and B, W, if lengths are in metres: exact with a
            light field, else estimated from 2²⁰ rays.
        lumens: the same as luminous flux, lm.
        exposure: factor on the radiance in the first row of the contact sheet.
        sheet: file of the contact sheet; None if none was written.
    """

    luminaire: str
    parts: tuple[str, ...]
    leaves: int
    size: tuple[float, ...]
    watts: tuple[float, ...]
    lumens: float
    exposure: float
    sheet: Path | None


@in_turn
def preview(
    luminaire: "Asset | LuminaireLike",
    sheet: FilePath | None = None,
    *,
    resolution: int = 256,
    spp: int = 64,
    bounces: bool = False,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> PreviewResult | AssetPreviewResult:
    """Render six views of a luminaire or of an asset, and measure its flux and size.

    The contact sheet shows the lamp in soft light, its own radiance at two exposures, and both
    opacities, from six sides. Warns of glass that Mitsuba cannot render correctly. Of an asset the
    sheet shows what images show of it, its geometry, its field or else its light field, and one
    opacity.

    Args:
        luminaire: what to render: an asset, the path of a `.lumitree` file, of a photometric file
            or of a ray file; or a luminaire in any form that `bake` takes except the folder of a
            dataset.
        sheet: path of the PNG file to write. Default: no file is written.
        resolution: pixels per side of each view, 1 to 16,384.
        spp: paths per pixel, 1 to 1,048,576. It does not apply to an asset without
            geometry, whose pixels have 16 rays.
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
    check_image_settings(resolution=resolution, spp=spp)
    mi = load_rgb(variant)
    if (asset := asset_of(luminaire)) is not None:
        if bounces:
            raise LumitreeError("an asset has no paths to count the bounces of; leave bounces out")
        with reporting(progress):
            return _preview_asset(asset, sheet, resolution, spp)
    from lumitree.core.images import max_radiance
    from lumitree.lamp.loading import load_luminaire
    from lumitree.output.preview_sheet import draw_preview, take_preview
    from lumitree.trace.flux import estimate_flux, missed_by_depth

    watch = Stopwatch()
    with reporting(progress):
        with watch.stage("load"):
            lamp = load_luminaire(cast(Any, luminaire))
        with watch.stage("diagnose"):
            faults = warn_of_faults(lamp)
        with watch.stage("views"):
            views = take_preview(lamp, resolution, spp)
        with watch.stage("flux"):
            flux = estimate_flux(lamp, FLUX_PATHS)
        missed = None
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
        flux=flux,
        paths_per_second=views.paths_per_second,
        exposure=views.exposure,
        faults=faults,
        bounces=missed,
        shapes=lamp.shapes,
        sheet=None if sheet is None else Path(sheet),
        png=b"",
        **watch.costs(),
    )
    settings = image_settings(
        "preview",
        luminaire=lamp.name,
        resolution=resolution,
        spp=spp,
        exposure=views.exposure,
        variant=mi.variant(),
    )
    png = draw_preview(views, lamp.name, _facts(result)).png(settings)
    if sheet is not None:
        write_bytes(sheet, png)
    return dataclasses.replace(result, png=png)


def _preview_asset(
    asset: Asset, sheet: FilePath | None, resolution: int, spp: int
) -> AssetPreviewResult:
    from lumitree.core.photometry import luminance
    from lumitree.output.preview_sheet import draw_preview, take_asset_preview
    from lumitree.rendering.asset_flux import asset_watts

    watch = Stopwatch()
    with watch.stage("views"):
        views = take_asset_preview(asset, resolution, spp)
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
        spp=None if asset.geometry is None else spp,
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
    return [
        f"{result.triangles:,} triangles",
        f"{result.emitters} emitter" + ("" if result.emitters == 1 else "s"),
        f"L_max {result.max_radiance:.4g}",
        f"flux {result.flux}",
        "size " + " x ".join(f"{side:.4g}" for side in result.size),
        *(["media"] if result.has_media else []),
    ]
