"""Preview of a luminaire or of an asset: figures, and a photograph, or six views on a sheet."""

import dataclasses
import math
from collections.abc import Callable, Sequence
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
from lumitree.core.images import encode_png, image_settings, max_radiance, tonemap
from lumitree.core.photometry import Flux, MissedFlux, luminance
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.progress import progress as progress_bar
from lumitree.core.results import ImageResult, Stopwatch
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.lamp.diagnosis import warn_of_faults
from lumitree.lamp.scene_shapes import SceneShape
from lumitree.rendering.asset_cache import asset_of
from lumitree.rendering.photograph import check_exposure, white_radiance

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire, LuminaireLike
    from lumitree.rendering.drawing import Sheet
    from lumitree.rendering.photograph import Photograph
    from lumitree.trace.cameras import ViewImages

# Numbers of light paths of a preview, for the flux and for the flux by number of bounces.
FLUX_PATHS, BOUNCE_PATHS = 1 << 18, 1 << 20
# Pixels per side and paths per pixel of the photograph, and of each view of a contact sheet: equal
# numbers of paths.
_PHOTOGRAPH, _VIEW = (512, 16), (256, 64)
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
    """Figures of a luminaire, and its photograph or a contact sheet of six views.

    Attributes:
        luminaire: name of the luminaire.
        triangles: number of triangles of its meshes.
        emitters: number of shapes that emit.
        max_radiance: L_max, the 99.99th percentile over the pixels of the views, W/(m² sr); None
            without a contact sheet.
        size: [3] sides of the bounding box, in the unit of the luminaire's file.
        has_media: whether there are participating media.
        flux: flux that leaves the luminaire.
        ev: exposure value of the image, EV100: 1.2 x 2^ev cd/m² is white.
        faults: one line for each fault that cannot be rendered correctly, such as a dielectric that
            is not closed.
        bounces: share of the flux that short paths miss; None if it was not measured.
        image: file that was written; None if none was.
        shapes: its shapes, with `number`, `name` (id), and `materials` (ids of BSDFs, names of
            materials), by which `keep` and `drop` find them; and with their plugins, `kind`, `bsdf`
            and `emitter`.
    """

    luminaire: str
    triangles: int
    emitters: int
    max_radiance: float | None
    size: tuple[float, ...]
    has_media: bool
    flux: Flux
    ev: float
    faults: list[str]
    image: Path | None
    bounces: list[MissedFlux] | None = None
    shapes: tuple[SceneShape, ...] = ()


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class AssetPreviewResult(ImageResult):
    """Figures of an asset, and its photograph or a contact sheet of six views.

    Attributes:
        luminaire: name of the luminaire.
        parts: which of "light", "field" and "geometry" it has.
        leaves: number of leaves of its field.
        size: [3] sides of the bounding box, in the unit of the luminaire's file.
        watts: [3] flux that it emits, R, G and B, W, if lengths are in metres: exact with a
            light field, else estimated from 2²⁰ rays.
        lumens: the same as luminous flux, lm.
        ev: exposure value of the image, EV100: 1.2 x 2^ev cd/m² is white.
        image: file that was written; None if none was.
    """

    luminaire: str
    parts: tuple[str, ...]
    leaves: int
    size: tuple[float, ...]
    watts: tuple[float, ...]
    lumens: float
    ev: float
    image: Path | None


@in_turn
def preview(
    luminaire: "Asset | LuminaireLike",
    output: FilePath | None = None,
    *,
    sheet: bool = False,
    resolution: int | None = None,
    spp: int | None = None,
    bounces: bool = False,
    exposure: float | str = 0.0,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> PreviewResult | AssetPreviewResult:
    """Photograph a luminaire or an asset, and measure its flux and size.

    The photograph shows the lamp in soft light, from obliquely in front. Warns of glass that
    Mitsuba cannot render correctly.

    The contact sheet shows six sides: the lamp in soft light, its own radiance at two exposures,
    and both opacities. For an asset it shows what images show of it, its geometry, its field or
    else its light field, and one opacity.

    Args:
        luminaire: what to render: an asset, the path of a `.lumitree` file, of a photometric file
            or of a ray file; or a luminaire in any form that `bake` takes except the folder of a
            dataset.
        output: path of the PNG file to write; a photograph is first written while it is noisy.
            Default: no file is written.
        sheet: whether to make the contact sheet in place of the photograph.
        resolution: pixels per side of the photograph or of each view, 1 to 16,384. Default: 512, or
            256 of a view.
        spp: paths per pixel, 1 to 1,048,576. It does not apply to an asset without
            geometry, whose pixels have 16 rays. Default: 16, or 64 of a view.
        bounces: whether to measure the share of the flux that paths of at most 32, 64 and 128
            bounces miss. Not for an asset.
        exposure: stops more than automatic, or "ev=9.5", as for `render`. Automatic shows the
            emitters well.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step; see `bake`.

    Returns:
        The figures of the luminaire or the asset (`AssetPreviewResult`), and the image as `png`.
        Figures of a luminaire list its `shapes`, for `keep` and `drop` of `load_luminaire`.

    Raises:
        LumitreeError: an argument is out of range; the luminaire cannot be read; or the file cannot
            be written.
    """
    if output is not None:
        check_sheet_output(output)
    pixels, samples = _VIEW if sheet else _PHOTOGRAPH
    resolution, spp = pixels if resolution is None else resolution, samples if spp is None else spp
    check_image_settings(resolution=resolution, spp=spp)
    check_exposure(exposure)
    load_rgb(variant)

    def image(lamp: "Asset | Luminaire", facts: list[str]) -> _Image:
        return _taken(lamp, facts, output, sheet, (resolution, spp), exposure)

    path, watch = None if output is None else Path(output), Stopwatch()
    if (asset := asset_of(luminaire)) is not None:
        if bounces:
            raise LumitreeError("an asset has no paths to count the bounces of; leave bounces out")
        with reporting(progress):
            return _preview_asset(asset, image, path, watch)
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.trace.flux import estimate_flux, missed_by_depth

    with reporting(progress):
        with watch.stage("load"):
            lamp = load_luminaire(luminaire)
        with watch.stage("diagnose"):
            faults = warn_of_faults(lamp)
        with watch.stage("flux"):
            flux = estimate_flux(lamp, FLUX_PATHS)
        missed = None
        if bounces:
            with watch.stage("bounces"):
                missed = missed_by_depth(lamp, BOUNCE_PATHS)
        facts = [
            f"{lamp.num_triangles:,} triangles",
            f"{lamp.num_emitters} emitter" + ("" if lamp.num_emitters == 1 else "s"),
            f"flux {flux}",
            "size " + " x ".join(f"{side:.4g}" for side in lamp.size),
            *(["media"] if lamp.has_media else []),
        ]
        with watch.stage("image"):
            taken = image(lamp, facts)
    return PreviewResult(
        luminaire=lamp.name,
        triangles=lamp.num_triangles,
        emitters=lamp.num_emitters,
        max_radiance=taken.max_radiance,
        size=tuple(lamp.size.tolist()),
        has_media=lamp.has_media,
        flux=flux,
        ev=taken.ev,
        faults=faults,
        bounces=missed,
        shapes=lamp.shapes,
        image=path,
        png=taken.png,
        **watch.costs(),
    )


def _preview_asset(
    asset: Asset,
    image: "Callable[[Asset, list[str]], _Image]",
    path: Path | None,
    watch: Stopwatch,
) -> AssetPreviewResult:
    from lumitree.rendering.asset_flux import asset_watts

    with watch.stage("flux"):
        watts = asset_watts(asset)
    lumens, size = float(luminance(watts)), asset.frame.size
    facts = [
        f"{' + '.join(asset.info.parts)}",
        f"shown: {asset.info.appearance}",
        f"flux {lumens:,.4g} lm",
        "size " + " x ".join(f"{side:.4g}" for side in size),
    ]
    with watch.stage("image"):
        taken = image(asset, facts)
    return AssetPreviewResult(
        luminaire=asset.luminaire,
        parts=asset.info.parts,
        leaves=asset.num_leaves,
        size=tuple(size.tolist()),
        watts=tuple(watts.tolist()),
        lumens=lumens,
        ev=taken.ev,
        image=path,
        png=taken.png,
        **watch.costs(),
    )


@dataclasses.dataclass(frozen=True)
class _Image:
    """PNG file of a photograph or a contact sheet, its EV100, and L_max of the views of a sheet."""

    png: bytes
    ev: float
    max_radiance: float | None = None


def _taken(
    lamp: "Asset | Luminaire",
    facts: list[str],
    output: FilePath | None,
    sheet: bool,
    size: tuple[int, int],
    exposure: float | str,
) -> _Image:
    """The image of a lamp, which is written; `size`: pixels per side and samples per pixel."""
    from lumitree.rendering.studio import portrait

    baked = isinstance(lamp, Asset)
    name = lamp.luminaire if baked else lamp.name
    spp = None if baked and lamp.geometry is None else size[1]

    def settings(ev: float) -> str:
        described = {"lamp": name, "resolution": size[0], "spp": spp, "ev": ev}
        return image_settings("preview", **described, variant=load_rgb().variant())

    def made(photograph: "Photograph") -> _Image:
        image = _Image(encode_png(photograph.pixels, settings(photograph.ev)), photograph.ev)
        if output is not None:
            write_bytes(output, image.png)
        return image

    if not sheet:
        return made(portrait(lamp, *size, exposure, None if output is None else made))
    views = (take_asset_preview if baked else take_preview)(cast(Any, lamp), *size, exposure)
    highest = max_radiance([views.radiance])
    facts = [*facts, f"L_max {highest:.4g}"]
    png = draw_preview(views, name, facts, baked=baked).png(settings(views.ev))
    if output is not None:
        write_bytes(output, png)
    return _Image(png, views.ev, highest)


@dataclasses.dataclass(frozen=True)
class Preview:
    """Images of a luminaire or of an asset.

    Attributes:
        images: by the names of `VIEWS`.
        photographs: of each view, sRGB bytes [H, W, 3], as `rendering.studio` makes them.
        exposed: exposure, as for `preview`.
    """

    images: "dict[str, ViewImages]"
    photographs: Sequence[NDArray[np.uint8]]
    exposed: float | str = 0.0

    @property
    def radiance(self) -> NDArray[np.float32]:
        """Radiance [6, H, W, 3] of all images, W/(m² sr)."""
        return np.stack([image.radiance for image in self.images.values()])

    @property
    def ev(self) -> float:
        """Exposure value of all images; the automatic one shows the emitters."""
        from lumitree.rendering.studio import lamp_ev

        return lamp_ev(self.exposed, lambda: self.radiance)

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
    poses = _poses(luminaire.bounding_radius)
    with progress_bar(f"preview {luminaire.name}", len(VIEWS)) as advance:
        for number, (name, pose) in enumerate(zip(VIEWS, poses, strict=True)):
            images[name] = camera.take(pose, SeedStream(Purpose.PREVIEW, number))
            advance(1)
    preview = Preview(images, [], exposure)
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
    preview = Preview(images, [], exposure)
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
