"""Images of scenes with luminaires placed in them."""

import contextlib
import dataclasses
import os
import re
from collections.abc import Callable, Mapping, Sequence
from concurrent.futures import Executor
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import check_image_settings, check_items, check_range, metres_of
from lumitree.core.backend import in_turn, load_mitsuba
from lumitree.core.checkpoint import Checkpoint
from lumitree.core.executor import check_executor
from lumitree.core.files import FilePath, WorkFolder
from lumitree.core.images import check_exr_name, encode_png, image_settings, write_exr
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.results import Json, Stopwatch
from lumitree.core.seeds import check_seed
from lumitree.errors import LumitreeError, explained
from lumitree.rendering.image import SavedImage
from lumitree.rendering.photograph import Highlights, PhotoSettings
from lumitree.rendering.placement import Placement
from lumitree.rendering.render_job import Described, RenderJob, renderer_of
from lumitree.rendering.view_transform import View

if TYPE_CHECKING:
    from lumitree.rendering.layers import Recorded
    from lumitree.rendering.passes import Rendering
    from lumitree.rendering.scene import CameraView

# Samples per pixel if no limit is given.
_SAMPLES_PER_PIXEL = 64
# The layer of all light that is of no placed luminaire.
_ROOM = "room"
# Longest name of a layer, without its number.
_NAME_BYTES = 200


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class RenderResult(SavedImage):
    """Rendered image of a scene.

    Attributes:
        pixels: float32 [height, width, 3], linear radiance, W/(m² sr).
        settings: what made the image, as JSON text; the comment of the files.
        ev: exposure value of `png`, EV100: 1.2 x 2^ev cd/m² is white.
        white_balance: colour temperature of light that `png` shows white, K; None for no
            adaptation.
        resolution: width and height in pixels.
        spp: samples per pixel.
        mean_radiance: mean over pixels and channels, W/(m² sr).
        noise: estimated standard error of a pixel before denoising, relative to the mean radiance
            around it, averaged over the image: neither the lamp itself nor what is nearly black
            decides. 0.1 is grain that is seen, 0.02 is hardly. None if there was one pass only.
        layers: by name, float32 [height, width, 3], the radiance of the light of one luminaire, or
            of the room; their sum is the image. Empty without the option `layers`.
        layer_highlights: by name, light of emitters that the camera sees, a part of each layer.
        noisy: float32 [height, width, 3], radiance before denoising; None as `albedo`.
        albedo: float32 [height, width, 3], diffuse reflectance of the first surface that is not
            specular, times the throughput up to it; None without `layers`, `aov` and `denoise`.
        normals: float32 [height, width, 3], shading normal of this surface in the frame of the
            scene; None as `albedo`.
        highlights: light of emitters that the camera sees, a part of `pixels`; None in spectral
            variants and for integrators other than `lumitree_path`.
        camera: where the camera stands and looks; None if it is not a perspective one, or its
            axis is not at the centre of the image.
    """

    resolution: tuple[int, int]
    spp: int
    mean_radiance: float
    noise: float | None = None
    layers: dict[str, NDArray[np.float32]] = dataclasses.field(default_factory=dict, repr=False)
    layer_highlights: dict[str, Highlights] = dataclasses.field(default_factory=dict, repr=False)
    noisy: NDArray[np.float32] | None = dataclasses.field(default=None, repr=False)
    albedo: NDArray[np.float32] | None = dataclasses.field(default=None, repr=False)
    normals: NDArray[np.float32] | None = dataclasses.field(default=None, repr=False)
    highlights: Highlights | None = dataclasses.field(default=None, repr=False)
    camera: "CameraView | None" = dataclasses.field(default=None, repr=False)

    @explained
    def save_layers(self, path: FilePath) -> None:
        """Write the layers, for `mix`.

        Args:
            path: path of the OpenEXR file, which has channels NAME.R, NAME.G and NAME.B for each
                layer. NAME.seen.R and so on have the part of emitters that the camera sees, and
                NAME.square its mean square, where there is any.

        Raises:
            LumitreeError: the image has no layers, the name does not end in `.exr`, or the file
                cannot be written.
        """
        check_exr_name(path)
        if not self.layers:
            raise LumitreeError("the image has no layers; render it with layers=True")
        channels = dict(self.layers)
        for name, highlights in self.layer_highlights.items():
            if highlights.square.any():
                channels |= {f"{name}.seen": highlights.seen, f"{name}.square": highlights.square}
        write_exr(path, channels, self.settings)

    @explained
    def save_aov(self, path: FilePath) -> None:
        """Write the image before denoising, and albedo and normal of the surfaces.

        Args:
            path: path of the OpenEXR file, with channels R, G, B, albedo.R and so on, and normal.X
                and so on.

        Raises:
            LumitreeError: the image has no albedo, the name does not end in `.exr`, or the file
                cannot be written.
        """
        check_exr_name(path)
        if self.noisy is None or self.albedo is None or self.normals is None:
            raise LumitreeError("the image has no albedo and normals; render it with aov=True")
        normal = {f"normal.{c}": self.normals[..., i] for i, c in enumerate("XYZ")}
        write_exr(path, {"RGB": self.noisy, "albedo": self.albedo, **normal}, self.settings)


@in_turn
def render(
    scene: "FilePath | Mapping[str, Any] | Any",
    placements: Sequence[Placement] = (),
    *,
    spp: int | None = None,
    time: float | None = None,
    noise: float | None = None,
    denoise: bool = False,
    layers: bool = False,
    aov: bool = False,
    width: int | None = None,
    unit: float | str = "m",
    exposure: float | str = 0.0,
    white_balance: float | str = "auto",
    view: View = "agx",
    bloom: float = 0.06,
    so_far: "Callable[[RenderResult], None] | None" = None,
    work: FilePath | None = None,
    seed: int = 0,
    variant: str | None = None,
    executor: Executor | None = None,
    progress: ProgressCallback | None = show_progress,
) -> RenderResult:
    """Render a scene with luminaires placed in it.

    The integrator `path` of the scene is replaced by `lumitree_path`, or by `volpath` if there are
    heterogeneous media. Warns of objects in a baked luminaire that are not lit there.

    The image is finished when the first of `spp`, `time` and `noise` is reached.

    Args:
        scene: what to render, with a camera: the path of a Mitsuba 3 scene (`.xml`), a dictionary
            as for `mitsuba.load_dict`, or a `mitsuba.Scene`. The film and the settings of the
            integrator `path` of a `mitsuba.Scene` cannot be changed: it is refused with a `width`,
            and with `denoise` if its reconstruction filter is no box.
        placements: the luminaires, baked or explicit, with position, size and rotation.
        spp: samples per pixel, 1 to 1,048,576. Default: 64, or no limit if there is
            a `time` or a `noise`.
        time: time of rendering, s, 0.001 to 10⁷, with compilation; one pass of at most 16 samples
            per pixel is always completed.
        noise: estimated relative error, 0.0001 to 1, as `RenderResult.noise`.
        denoise: filter the noise out with Open Image Denoise, illumination and emitters that are
            seen directly apart. Needs the optional dependency `denoise`. The scene's
            reconstruction filter becomes a box.
        layers: whether the light of each luminaire and of the room is also returned separately,
            for `mix`. The layers are named by `Placement.label`, and "room".
        aov: whether albedo and normal of the first surface that is not specular are also returned.
        width: width of the image in pixels, 1 to 16,384; the aspect ratio stays. Default: the
            scene's.
        unit: unit of length of the scene: "m", "cm", "mm", "in", "ft", or the metres in a unit. It
            counts for `Placement.lumens` and for photometric files, which state metres.
        exposure: stops more than automatic, -40 to 40, such as 1 for twice as bright; or "ev=9.5",
            an exposure value EV100, at which 1.2 x 2^9.5 cd/m² is white. Automatic is by the
            log-average luminance of the image without lamps, windows and openings into the dark.
        white_balance: "auto", 70 % of the way from daylight to the colour of the light on the
            scene, so that warm light stays a little warm, while light that is coloured on purpose
            keeps its colour; the colour temperature of a light that is to be white, K, 1000 to
            20,000; or "off".
        view: view transform of `png`: "agx", in which bright colours approach white slowly; or
            "srgb", which clips them; for measuring, with a white balance "off" and no bloom.
        bloom: share of the light of `png` that is scattered as in a lens or an eye, 0 to 1.
        so_far: function that is called with the image so far, without layers and before denoising,
            after the first pass and then every two seconds or more.
        work: folder in which the passes so far are kept every half minute, and at the end. The same
            call continues them, also with another time or noise, as long as the scene and the
            luminaires, which have to be paths, are the same. Default: nothing is kept.
        seed: root seed of all random numbers, 0 to 2³¹ - 1.
        variant: Mitsuba variant, as for `bake`; or "llvm_ad_spectral" or "cuda_ad_spectral", which
            render spectra, but neither `denoise`, `layers` nor `aov`.
        executor: its workers render the passes; each loads the scene. With a number of samples or a
            `noise` the image equals the image of one process, apart from the last digits. Default:
            this process.
        progress: function that is called with a `Progress` after each pass; see `bake`.

    Returns:
        The image as `pixels`, float32 [height, width, 3], linear radiance in W/(m² sr), and as
        `png`. `RenderResult.save` and others write files.

    Raises:
        LumitreeError: an argument is out of range; the scene, an asset or a luminaire cannot be
            read; the scene has no camera; two placements are equal; `denoise`, `layers` or `aov`
            is asked for in a scene with heterogeneous media; `work` is given, and the scene or a
            luminaire is no path, or another process works there; Open Image Denoise
            is not installed; a worker is lost; or the scene cannot be sent to the workers of
            `executor`, such as a `mitsuba.Scene`.
    """
    if (spp, time, noise) == (None, None, None):
        spp = _SAMPLES_PER_PIXEL
    _check(spp, time, noise, width)
    check_items("placements", placements, Placement)
    placements = [lamp for placement in placements for lamp in placement.each()]
    check_seed(seed)
    settings = PhotoSettings(exposure=exposure, white_balance=white_balance, view=view, bloom=bloom)
    metres = metres_of(unit)
    check_executor(executor)
    mi = load_mitsuba(variant)
    if mi.is_spectral and (denoise or layers or aov):
        raise LumitreeError(
            f"denoise, layers and aov need an RGB variant of Mitsuba, not {mi.variant()}"
        )
    from lumitree.rendering.layers import check_denoiser, denoised
    from lumitree.rendering.passes import Budget

    if denoise:
        check_denoiser()
    names, watch = layer_names(placements), Stopwatch()

    def result(
        rendering: "Rendering", pixels: NDArray[np.float32], filtered: bool, **parts: Any
    ) -> RenderResult:
        highlights = job.highlights(rendering)
        photograph = settings.photograph(pixels, albedo=parts.get("albedo"), highlights=highlights)
        comment = image_settings(
            "render",
            scene=Path(scene).name if isinstance(scene, str | os.PathLike) else None,
            lamps=dict(zip(names[1:], map(_described, placements, watts), strict=True)),
            integrator=type(job.integrator).__name__,
            spp=rendering.spp,
            time=time,
            noise=rendering.noise,
            denoise=filtered,
            unit=unit,
            **photograph.described(settings),
            seed=seed,
            variant=mi.variant(),
        )
        return RenderResult(
            pixels=pixels,
            settings=comment,
            ev=photograph.ev,
            white_balance=photograph.white_balance,
            resolution=(pixels.shape[1], pixels.shape[0]),
            spp=rendering.spp,
            noise=rendering.noise,
            mean_radiance=float(pixels.mean()),
            highlights=highlights,
            camera=job.camera,
            png=encode_png(photograph.pixels, comment),
            **parts,
            **watch.costs(),
        )

    def show(rendering: "Rendering") -> None:
        assert so_far is not None
        so_far(result(rendering, rendering.radiance, False))

    by_lamp = layers if denoise or layers or aov else None
    with reporting(progress):
        with watch.stage("load"):
            described = Described(scene, placements, width, metres, denoise, by_lamp)
            renderer = None if executor is None else renderer_of(executor, described)
            job = RenderJob(described)
            watts = job.watts() if layers else [None] * len(placements)
        with watch.stage("render"), contextlib.ExitStack() as stack:
            budget = Budget(spp, time, noise)
            shown, saved = None if so_far is None else show, None
            if work is not None:
                identity = job.identity(seed)
                folder = stack.enter_context(WorkFolder(work)).path
                saved = Checkpoint(folder / "passes.npz", identity, "image")
            rendering, recorded = job.rendered(budget, seed, shown, renderer, saved)
    pixels = noisy = rendering.radiance
    if recorded is not None and denoise:
        with watch.stage("denoise"):
            recorded = denoised(recorded)
        pixels = recorded.radiance.sum(axis=0)
    return result(rendering, pixels, denoise, **_parts(recorded, noisy, names if layers else ()))


def _check(spp: int | None, time: float | None, noise: float | None, width: int | None) -> None:
    sizes = {"spp": spp, "width": width}
    check_image_settings(**{name: value for name, value in sizes.items() if value is not None})
    if time is not None:
        check_range("time", time, 1e-3, 1e7)
    if noise is not None:
        check_range("noise", noise, 1e-4, 1)


def _parts(recorded: "Recorded | None", noisy: NDArray[np.float32], names: Sequence[str]) -> Json:
    """Parts of a `RenderResult` beside the image; with names, the layers too."""
    if recorded is None:
        return {}
    parts: Json = {}
    if names:
        parts["layers"] = dict(zip(names, recorded.radiance, strict=True))
        parts["layer_highlights"] = dict(zip(names, recorded.highlights, strict=True))
    return {
        **parts,
        "noisy": noisy,
        "albedo": recorded.albedo,
        "normals": recorded.normal,
    }


def _described(placement: Placement, watts: NDArray[np.float64] | None) -> Json:
    """The given values of a placement, for the comment of an image; with its flux [3], W."""
    values = {field.name: getattr(placement, field.name) for field in dataclasses.fields(placement)}
    given = {name: value for name, value in values.items() if value is not None}
    flux = {} if watts is None else {"watts": watts}
    return {**given, "source": placement.name, **flux}


def layer_names(placements: Sequence[Placement]) -> list[str]:
    """Names of the layers: each once, of letters, digits, "_" and "-".

    OpenEXR files have other channels by the names RGB and RGBA.
    """
    names = [_ROOM]
    for placement in placements:
        start = placement.label or Path(placement.name).stem
        start = re.sub(r"[^\w-]+", "_", start) or "lamp"
        # Names of channels have 255 bytes at most.
        start = start.encode()[:_NAME_BYTES].decode(errors="ignore")
        name, number = start, 1
        while name in (*names, "RGB", "RGBA"):
            number += 1
            name = f"{start}_{number}"
        names.append(name)
    return names
