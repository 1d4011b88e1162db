"""Images of scenes with luminaires placed in them, and mixtures of their layers."""

import dataclasses
import re
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import check_gain, check_image_settings, check_range
from lumitree.core.backend import load_mitsuba
from lumitree.core.files import FilePath, check_writable
from lumitree.core.image_settings import image_settings
from lumitree.core.images import (
    check_image_name,
    encode_png,
    read_comment,
    read_exr,
    write_exr,
    write_image,
)
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.results import ImageResult
from lumitree.core.seeds import check_seed
from lumitree.core.stopwatch import Stopwatch
from lumitree.errors import LumitreeError, explained, shown

if TYPE_CHECKING:
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.sampling.proxy import ProxyKind

# Samples per pixel if no limit is given.
_SAMPLES_PER_PIXEL = 64
# The layer of all light that is of no placed luminaire.
_ROOM = "room"


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class RenderResult(ImageResult):
    """Rendered image of a scene.

    Attributes:
        pixels: float32 [height, width, 3], linear radiance, W/(m² sr).
        image: file of the image; None if none was written.
        resolution: width and height in pixels.
        samples_per_pixel: samples per pixel.
        mean_radiance: mean over pixels and channels, W/(m² sr).
        noise: estimated standard error of the pixels before denoising: its sum over all pixels,
            relative to the sum of their radiance. None if there was one pass only.
        layers: file of the layers; None if none was written.
        aov: file of albedo and normal; None if none was written.
    """

    pixels: NDArray[np.float32] = dataclasses.field(repr=False)
    image: Path | None
    resolution: tuple[int, int]
    samples_per_pixel: int
    mean_radiance: float
    noise: float | None = None
    layers: Path | None = None
    aov: Path | None = None


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class MixResult(ImageResult):
    """Image that was mixed from layers.

    Attributes:
        pixels: float32 [height, width, 3], linear radiance, W/(m² sr).
        image: file of the image; None if none was written.
        layers: names of the layers.
        resolution: width and height in pixels.
        mean_radiance: mean over pixels and channels, W/(m² sr).
    """

    pixels: NDArray[np.float32] = dataclasses.field(repr=False)
    image: Path | None
    layers: list[str]
    resolution: tuple[int, int]
    mean_radiance: float


@explained
def render(
    scene: FilePath,
    placements: "Sequence[Placement]" = (),
    output: FilePath | None = None,
    *,
    samples_per_pixel: int | None = None,
    time: float | None = None,
    noise: float | None = None,
    denoise: bool = False,
    layers: FilePath | None = None,
    aov: FilePath | None = None,
    width: int | None = None,
    proxy: "ProxyKind" = "box",
    seed: int = 0,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> RenderResult:
    """Render a scene file with luminaires placed in it.

    The integrator `path` of the scene is replaced by `lumitree_path`, or by `volpath` if there are
    heterogeneous media. Warns if an object or the camera is inside a baked luminaire.

    The image is finished when the first of `samples_per_pixel`, `time` and `noise` is reached.

    Args:
        scene: path of a Mitsuba 3 scene (`.xml`) with a camera.
        placements: the luminaires, baked or explicit, with position, size and rotation.
        output: path of the image to write, `.exr` (linear radiance) or `.png` (tone-mapped).
            Default: no file is written.
        samples_per_pixel: samples per pixel, 1 to 1,048,576. Default: 64, or no limit if there is
            a `time` or a `noise`.
        time: time of rendering, s, 0.001 to 10⁷, with compilation; one pass of at most 16 samples
            per pixel is always completed.
        noise: estimated relative error, 0.0001 to 1, as `RenderResult.noise`.
        denoise: filter the noise out with Open Image Denoise, illumination and emitters that are
            seen directly apart. Needs the optional dependency `denoise`. The scene's
            reconstruction filter becomes a box.
        layers: path of an OpenEXR file to write, with the light of each luminaire and of the room
            as layers for `mix`. They are named by `Placement.label`, and "room".
        aov: path of an OpenEXR file to write, with the image before denoising, and albedo and
            normal of the first surface that is not specular.
        width: width of the image in pixels, 1 to 16,384; the aspect ratio stays. Default: the
            scene's.
        proxy: surface that carries a baked luminaire, "box" or "sphere".
        seed: root seed of all random numbers, 0 to 2³¹ - 1.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each pass; see `bake`.

    Returns:
        The image as `pixels`, float32 [height, width, 3], linear radiance in W/(m² sr), and
        tone-mapped as `png`.

    Raises:
        LumitreeError: an argument is out of range; the scene, an asset or a luminaire cannot be
            read; the scene has no camera; two placements are equal; `denoise`, `layers` or `aov`
            is asked for in a scene with heterogeneous media, or without the denoiser; or the
            image cannot be written.
    """
    if output is not None:
        check_image_name(output)
        check_writable(output)
    for path in (layers, aov):
        if path is not None:
            _check_exr(path)
    if (samples_per_pixel, time, noise) == (None, None, None):
        samples_per_pixel = _SAMPLES_PER_PIXEL
    sizes = {"spp": samples_per_pixel, "width": width}
    check_image_settings(**{name: value for name, value in sizes.items() if value is not None})
    if time is not None:
        check_range("time", time, 1e-3, 1e7)
    if noise is not None:
        check_range("noise", noise, 1e-4, 1)
    check_seed(seed)
    mi = load_mitsuba(variant)
    from lumitree.rendering.denoise import check_denoiser
    from lumitree.rendering.denoise import denoise as denoised
    from lumitree.rendering.layers import Layers
    from lumitree.rendering.passes import Budget, render_passes
    from lumitree.rendering.scene import (
        appearance_for,
        load_scene,
        open_placements,
        place_luminaires,
        placed_ids,
        set_film_width,
    )

    if denoise:
        check_denoiser()
    divides = denoise or layers is not None or aov is not None
    watch = Stopwatch()
    with reporting(progress):
        with watch.stage("load"):
            placed = open_placements(placements)
            loaded, integrator = load_scene(str(scene), placed, box_filter=denoise)
            if width is not None:
                set_film_width(loaded, width)
            appearance = appearance_for(integrator)
            whole = place_luminaires(loaded, placed, proxy, appearance=appearance)
            if divides:
                if not hasattr(integrator, "layers"):
                    raise LumitreeError(
                        f"{shown(scene)} is rendered by volpath, because of heterogeneous media; "
                        "denoise, layers and aov need lumitree_path: make the media homogeneous, "
                        "or render without them"
                    )
                integrator.layers = Layers(whole, placed_ids(placed) if layers is not None else ())
        with watch.stage("render"):
            budget = Budget(samples_per_pixel, time, noise)
            rendering = render_passes(whole, integrator, budget, seed=seed)
    pixels, names = rendering.radiance, _names(placements)
    settings = image_settings(
        "render",
        scene=Path(scene).name,
        lamps=dict(zip(names[1:], map(_described, placements), strict=True)),
        integrator=type(integrator).__name__,
        samples_per_pixel=rendering.samples_per_pixel,
        time=time,
        noise=rendering.noise,
        denoise=denoise,
        proxy=proxy,
        seed=seed,
        variant=mi.variant(),
    )
    if divides:
        recorded = integrator.layers.divide(rendering.channels[..., 3:])
        if aov is not None:
            normal = {f"normal.{c}": recorded.normal[..., i] for i, c in enumerate("XYZ")}
            channels = {"RGB": pixels, "albedo": recorded.albedo, **normal}
            write_exr(aov, channels, settings)
        if denoise:
            with watch.stage("denoise"):
                recorded = denoised(recorded)
            pixels = (recorded.seen + recorded.lit).sum(axis=0)
        if layers is not None:
            light = dict(zip(names, recorded.seen + recorded.lit, strict=True))
            write_exr(layers, light, settings)
    if output is not None:
        write_image(output, pixels, settings=settings)
    return RenderResult(
        pixels=pixels,
        image=None if output is None else Path(output),
        layers=None if layers is None else Path(layers),
        aov=None if aov is None else Path(aov),
        resolution=(pixels.shape[1], pixels.shape[0]),
        samples_per_pixel=rendering.samples_per_pixel,
        noise=rendering.noise,
        mean_radiance=float(pixels.mean()),
        png=encode_png(pixels, settings=settings),
        **watch.costs(),
    )


@explained
def mix(
    layers: FilePath,
    output: FilePath | None = None,
    gains: Mapping[str, float | tuple[float, float, float]] | None = None,
) -> MixResult:
    """Change the brightness and the colour of lamps in an image, without rendering it again.

    Args:
        layers: path of an OpenEXR file that `render` has written as `layers`.
        output: path of the image to write, `.exr` (linear radiance) or `.png` (tone-mapped).
            Default: no file is written.
        gains: by name of the layer, factors [3] on R, G and B of its light, or one number for all;
            0 to 10⁶. Default: 1.

    Returns:
        The image as `pixels`, float32 [height, width, 3], linear radiance in W/(m² sr), and
        tone-mapped as `png`.

    Raises:
        LumitreeError: the file is missing, damaged or has no layers; a gain is out of range or of
            a layer that the file does not have; or the image cannot be written.
    """
    if output is not None:
        check_image_name(output)
        check_writable(output)
    factors = {name: check_gain(gain) for name, gain in (gains or {}).items()}
    watch = Stopwatch()
    with watch.stage("mix"):
        colours = {n: c for n, c in read_exr(layers).items() if c.ndim == 3 and n != "RGB"}
        if not colours:
            raise LumitreeError(
                f"{shown(layers)} has no layers NAME.R, NAME.G and NAME.B; expected a file of "
                "`lumitree render --layers`"
            )
        for name in factors.keys() - colours.keys():
            raise LumitreeError(
                f"{shown(layers)} has no layer {shown(repr(name), 100)}; it has "
                f"{shown(', '.join(sorted(colours)), 300)}"
            )
        scaled = [
            colour * np.array(factors.get(name, (1, 1, 1)), np.float32)
            for name, colour in colours.items()
        ]
        pixels = np.sum(scaled, axis=0)
        rendered = read_comment(layers)
    settings = image_settings("mix", layers=Path(layers).name, gains=factors, rendered=rendered)
    if output is not None:
        write_image(output, pixels, settings=settings)
    return MixResult(
        pixels=pixels,
        image=None if output is None else Path(output),
        layers=sorted(colours),
        resolution=(pixels.shape[1], pixels.shape[0]),
        mean_radiance=float(pixels.mean()),
        png=encode_png(pixels, settings=settings),
        **watch.costs(),
    )


def _check_exr(path: FilePath) -> None:
    if Path(path).suffix.lower() != ".exr":
        raise LumitreeError(
            f"{shown(repr(str(path)), 300)} does not end in .exr; layers and buffers are linear"
        )
    check_writable(path)


def _described(placement: "Placement") -> dict[str, Any]:
    """A placement for the comment of an image: what was given of it."""
    values = {field.name: getattr(placement, field.name) for field in dataclasses.fields(placement)}
    given = {name: value for name, value in values.items() if value is not None}
    return {**given, "source": placement.name}


def _names(placements: "Sequence[Placement]") -> list[str]:
    """Names of the layers: each once, of letters, digits, "_" and "-"."""
    names = [_ROOM]
    for placement in placements:
        start = placement.label or Path(placement.name).stem
        start = re.sub(r"[^\w-]+", "_", start) or "lamp"
        name, number = start, 1
        while name in names:
            number += 1
            name = f"{start}_{number}"
        names.append(name)
    return names
