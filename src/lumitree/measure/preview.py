"""Preview of a luminaire or of an asset: figures, and six views on a contact sheet."""

import dataclasses
import math
import time
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.arguments import (
    check_image_settings,
    check_sheet_output,
)
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.files import FilePath, write_bytes
from lumitree.core.frames import pose_towards
from lumitree.core.images import auto_exposure, image_settings, max_radiance, tonemap
from lumitree.core.photometry import Flux, MissedFlux, luminance
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.progress import progress as progress_bar
from lumitree.core.results import ImageResult, Stopwatch
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.lamp.diagnosis import warn_of_faults
from lumitree.lamp.scene_shapes import SceneShape
from lumitree.rendering.asset_cache import asset_of
from lumitree.rendering.photograph import (
    check_exposure,
    ev_of_white,
    exposure_value,
    white_radiance,
)

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire, LuminaireLike
    from lumitree.rendering.drawing import Sheet
    from lumitree.trace.cameras import ViewImages

# Numbers of light paths of a preview, for the flux and for the flux by number of bounces.
FLUX_PATHS, BOUNCE_PATHS = 1 << 22, 1 << 20
# Direction from the luminaire to the camera, and the direction that is upwards in the image, in the
# frame of the luminaire's file, where y is up.
VIEWS = {
    "from the front, +z": ((0, 0, 1), (0, 1, 0)),
    "from the right, +x": ((1, 0, 0), (0, 1, 0)),
    "from the back, -z": ((0, 0, -1), (0, 1, 0)),
    "from the left, -x": ((-1, 0, 0), (0, 1, 0)),
    "from above, +y": ((0, 1, 0), (0, 0, -1)),
    "from below, -y": ((0, -1, 0), (0, 0, 1)),
}
_MIN_STOPS = 2
# Limits of the side of an image on the sheet, pixels.
_MIN_SIDE, _MAX_SIDE = 192, 640


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
        ev: exposure value of the contact sheet, EV100: 1.2 x 2^ev cd/m² is white.
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
    ev: float
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
        ev: exposure value of the contact sheet, EV100: 1.2 x 2^ev cd/m² is white.
        sheet: file of the contact sheet; None if none was written.
    """

    luminaire: str
    parts: tuple[str, ...]
    leaves: int
    size: tuple[float, ...]
    watts: tuple[float, ...]
    lumens: float
    ev: float
    sheet: Path | None


@in_turn
def preview(
    luminaire: "Asset | LuminaireLike",
    output: FilePath | None = None,
    *,
    resolution: int = 256,
    spp: int = 64,
    bounces: bool = False,
    exposure: float | str = 0.0,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> PreviewResult | AssetPreviewResult:
    """Render six views of a luminaire or of an asset, and measure its flux and size.

    The contact sheet shows the lamp in soft light, its own radiance at two exposures, and both
    opacities, from six sides. Warns of glass that Mitsuba cannot render correctly. For an asset the
    sheet shows what images show of it, its geometry, its field or else its light field, and one
    opacity.

    Args:
        luminaire: what to render: an asset, the path of a `.lumitree` file, of a photometric file
            or of a ray file; or a luminaire in any form that `bake` takes except the folder of a
            dataset.
        output: path of the PNG file to write. Default: no file is written.
        resolution: pixels per side of each view, 1 to 16,384.
        spp: paths per pixel, 1 to 1,048,576. It does not apply to an asset without
            geometry, whose pixels have 16 rays.
        bounces: whether to measure the share of the flux that paths of at most 32, 64 and 128
            bounces miss. Not for an asset.
        exposure: stops more than automatic, or "ev=9.5", as for `render`. Automatic shows the
            emitters well.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step; see `bake`.

    Returns:
        The figures of the luminaire or the asset (`AssetPreviewResult`), and the contact sheet as
        `png`. Figures of a luminaire list its `shapes`, for `keep` and `drop` of `load_luminaire`.

    Raises:
        LumitreeError: an argument is out of range; the luminaire cannot be read; or the file cannot
            be written.
    """
    if output is not None:
        check_sheet_output(output)
    check_image_settings(resolution=resolution, spp=spp)
    check_exposure(exposure)
    mi = load_rgb(variant)
    if (asset := asset_of(luminaire)) is not None:
        if bounces:
            raise LumitreeError("an asset has no paths to count the bounces of; leave bounces out")
        with reporting(progress):
            return _preview_asset(asset, output, resolution, spp, exposure)
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.trace.flux import estimate_flux, missed_by_depth

    watch = Stopwatch()
    with reporting(progress):
        with watch.stage("load"):
            lamp = load_luminaire(cast(Any, luminaire))
        with watch.stage("diagnose"):
            faults = warn_of_faults(lamp)
        with watch.stage("views"):
            views = take_preview(lamp, resolution, spp, exposure)
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
        ev=views.ev,
        faults=faults,
        bounces=missed,
        shapes=lamp.shapes,
        sheet=None if output is None else Path(output),
        png=b"",
        **watch.costs(),
    )
    settings = image_settings(
        "preview",
        luminaire=lamp.name,
        resolution=resolution,
        spp=spp,
        ev=views.ev,
        variant=mi.variant(),
    )
    png = draw_preview(views, lamp.name, _facts(result)).png(settings)
    if output is not None:
        write_bytes(output, png)
    return dataclasses.replace(result, png=png)


def _preview_asset(
    asset: Asset, sheet: FilePath | None, resolution: int, spp: int, exposure: float | str
) -> AssetPreviewResult:
    from lumitree.rendering.asset_flux import asset_watts

    watch = Stopwatch()
    with watch.stage("views"):
        views = take_asset_preview(asset, resolution, spp, exposure)
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
        ev=views.ev,
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
        ev=views.ev,
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


@dataclasses.dataclass(frozen=True)
class Preview:
    """Images of a luminaire or of an asset.

    Attributes:
        images: by the names of `VIEWS`.
        photographs: of each view, sRGB bytes [H, W, 3], as `rendering.studio` makes them.
        paths_per_second: paths traced per second, without the time of compilation.
        exposed: exposure, as for `preview`.
    """

    images: "dict[str, ViewImages]"
    photographs: Sequence[NDArray[np.uint8]]
    paths_per_second: float
    exposed: float | str = 0.0

    @property
    def radiance(self) -> NDArray[np.float32]:
        """Radiance [6, H, W, 3] of all images, W/(m² sr)."""
        return np.stack([image.radiance for image in self.images.values()])

    @property
    def ev(self) -> float:
        """Exposure value of all images; the automatic one shows the emitters."""
        return exposure_value(self.exposed, ev_of_white(1 / auto_exposure(self.radiance)))

    @property
    def exposure(self) -> float:
        """The same as a factor on the radiance."""
        return 1 / white_radiance(self.ev)

    @property
    def more_stops(self) -> int:
        """Whole stops above `exposure` at which the median of the lit pixels is middle grey.

        At this exposure the body of the lamp is visible. It is often a thousand times darker than
        the emitters.
        """
        brightest = self.radiance.max(axis=-1)
        lit = brightest[brightest > 0]
        if not lit.size:
            return _MIN_STOPS
        return max(round(math.log2(0.18 / float(np.median(lit)) / self.exposure)), _MIN_STOPS)


def take_preview(
    luminaire: "Luminaire", resolution: int, spp: int, exposure: float | str = 0.0
) -> Preview:
    """Render the six views, with `resolution` pixels per side."""
    from lumitree.rendering.studio import luminaire_photographs
    from lumitree.trace.cameras import Camera

    camera = Camera(luminaire, resolution, spp)
    images: dict[str, ViewImages] = {}
    seconds = []
    poses = _poses(luminaire.bounding_radius)
    with progress_bar(f"preview {luminaire.name}", len(VIEWS)) as advance:
        for number, (name, pose) in enumerate(zip(VIEWS, poses, strict=True)):
            start = time.perf_counter()
            images[name] = camera.take(pose, SeedStream(Purpose.PREVIEW, number))
            seconds.append(time.perf_counter() - start)
            advance(1)
    # The first view is not counted, because its time includes compilation.
    paths = resolution**2 * spp * (len(VIEWS) - 1)
    preview = Preview(images, [], paths / sum(seconds[1:]), exposure)
    photographs = luminaire_photographs(luminaire, poses, resolution, spp, preview.exposure)
    return dataclasses.replace(preview, photographs=photographs)


def take_asset_preview(
    asset: Asset, resolution: int, spp: int, exposure: float | str = 0.0
) -> Preview:
    """Render the six views of an asset, with the camera of its luminaire's preview.

    Both opacities are the one of `shown_images`. The camera's sphere contains the bounding box.
    """
    from lumitree.rendering.asset_images import shown_images
    from lumitree.rendering.studio import asset_photographs
    from lumitree.trace.cameras import ViewImages

    radius = float(np.linalg.norm(asset.frame.half_extents))
    poses = _poses(radius)
    shown = shown_images(asset, poses, radius, resolution, spp)
    images = {
        name: ViewImages(radiance, opacity, opacity)
        for name, (radiance, opacity) in zip(VIEWS, shown, strict=True)
    }
    preview = Preview(images, [], 0.0, exposure)
    photographs = asset_photographs(asset, poses, radius, resolution, spp, preview.exposure)
    return dataclasses.replace(preview, photographs=photographs)


def _poses(radius: float) -> list[NDArray[np.float64]]:
    """`local_from_camera` [4, 4] of the views of a sphere of this radius, local units."""
    return [pose_towards(backward, up, 2 * radius) for backward, up in VIEWS.values()]


def draw_preview(
    preview: Preview, title: str, facts: Sequence[str], *, baked: bool = False
) -> "Sheet":
    """Contact sheet with a column for each view; `facts` are in the line below the title.

    Rows: the lamp in soft light, its own radiance at two exposures, geometric opacity and
    straight-through opacity; of an asset, which is `baked`, the two are one.
    """
    from lumitree.rendering.drawing import OPACITY, Tile, image_grid

    exposure, stops, views = preview.exposure, preview.more_stops, preview.images.values()
    bright = exposure * 2**stops
    rows: dict[str, Sequence[NDArray[Any]]] = {
        "in soft light": preview.photographs,
        "radiance": [tonemap(view.radiance, exposure) for view in views],
        f"radiance, {stops} stops brighter": [tonemap(view.radiance, bright) for view in views],
        "opacity" if baked else "geometric opacity": [OPACITY(view.geometric) for view in views],
    }
    if not baked:
        rows["straight-through opacity"] = [OPACITY(view.straight_through) for view in views]
    return image_grid(
        [[Tile(image) for image in row] for row in rows.values()],
        min(max(preview.radiance.shape[1], _MIN_SIDE), _MAX_SIDE),
        title=title,
        subtitle="   ·   ".join([*facts, f"EV {preview.ev:.1f} in all views"]),
        columns=list(preview.images),
        names=list(rows),
    )
