"""The page with a dimmer for each layer of an image.

Layers are compressed by what they share: surfaces have one reflectance in all of them, so a layer
over the sum of the layers is smooth.

Symbols
    x       radiance relative to white of the automatic exposure
    u(x)    log2(1 + x / _LEAST): it has equal relative steps where there is light
    k       code of the sum of all layers, _STEPS u(x) rounded; it is stored without loss
    d       code of a layer, 2 _STEPS u(x) - 2 k

A plane has the codes of green, or the differences of red or blue from green. It is transformed by
the integer wavelet 5/3 of JPEG 2000. Coefficients of layers are divided by a step, which is halved
from each level to the next coarser one, and is chosen by the size of the page. Noise would need
many times the bytes of an image without, so shares of noisy layers are filtered. The page scales
the layers so that they add up to the sum.
"""

import dataclasses
import json
from collections.abc import Iterator, Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray
from scipy.ndimage import gaussian_filter, median_filter

from lumitree.asset.array_stream import Arrays
from lumitree.core.arguments import check_gain
from lumitree.core.photometry import (
    LUMA,
    MAX_TEMPERATURE,
    MIN_TEMPERATURE,
    blackbody_colour,
    colour_temperature,
    srgb_from_xyz,
)
from lumitree.core.results import Json
from lumitree.errors import LumitreeError
from lumitree.rendering.photograph import (
    BLOOM,
    FILTER,
    MOST,
    Highlights,
    PhotoSettings,
    automatic_ev,
    light_on_scene,
    white_radiance,
)
from lumitree.rendering.placement import Placement, placements_toml
from lumitree.viewer.packing import packed_arrays
from lumitree.viewer.view import page_file, web_page

# Codes of an octave of the sum: half a step is 0.7 %. Radiance below which they are linear.
_STEPS, _LEAST = 48, 2.0**-16
# Largest radiance; half floats have up to 65504.
_LARGEST = 6e4
_LEVELS = 5
# Steps of the coefficients; the first for which a page has at most so many bytes for a pixel, and
# for a pixel of each layer.
_LAYER_STEPS = (2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
_BYTES, _BYTES_OF_LAYER = 1.0, 0.42
# Standard deviations of the filter of noisy layers, pixels. Pixels of more than this over white
# show emitters.
_DEVIATIONS, _EMITTER = (0, 1, 2, 4, 8), 4.0
# Coefficients below this part of a step become 0.
_DEAD = 0.6
# zlib needs more bytes than the entropy.
_OVER_ENTROPY = 1.16
# Texels of all layers, which take 8 bytes each on the GPU; and layers.
_MAX_TEXELS, _MAX_LAYERS = 50_000_000, 64
_TEMPERATURES = np.geomspace(MIN_TEMPERATURE, MAX_TEMPERATURE, 64)
_SCRIPTS = ("gl.js", "layers.js", "dimmers.js")
_SHADERS = ("sum", "filters", "photo")


def dimmer_page(
    layers: "Mapping[str, NDArray[np.float32]]",
    highlights: Mapping[str, Highlights],
    gain: Mapping[str, tuple[float, float, float]],
    photo: PhotoSettings,
    ev: float,
    *,
    file: str | None = None,
    rendered: str | None = None,
) -> str:
    """HTML text of the page of an image.

    Args:
        layers, highlights, file, rendered: as of `ImageLayers`.
        gain: factors [3] of layers, with which the page begins.
        photo: how the photograph is taken at the beginning.
        ev: its exposure, EV100.

    Raises:
        LumitreeError: there are too many layers or pixels.
    """
    lit = {name: light for name, light in layers.items() if light.any()}
    lit = dict(sorted(lit.items(), key=lambda item: item[0] == "room"))
    height, width = next(iter(layers.values())).shape[:2]
    texels = height * width * (len(lit) + 1)
    if not lit:
        raise LumitreeError("all layers are black; render the image with a light")
    if texels > _MAX_TEXELS or len(lit) > _MAX_LAYERS:
        raise LumitreeError(
            f"the image has {len(lit)} layers of {width} x {height} pixels; a page shows at most "
            f"{_MAX_LAYERS} layers and {_MAX_TEXELS // (len(lit) + 1):,} pixels of so many: render "
            "it with a smaller width"
        )
    metered = np.stack(list(layers.values())).sum(axis=0, dtype=np.float64)
    zero = automatic_ev(metered)
    white = white_radiance(zero)
    coded = coded_layers(list(lit.values()), white)
    arrays, columns = coded.arrays, {}
    if any(name in highlights for name in lit):
        arrays["seen"], columns = _seen(lit, highlights, white)
    described, block = packed_arrays(arrays, in_planes={"seen"})
    automatic = PhotoSettings().white(metered)
    content: Json = {
        "title": Path(file).stem if file else "Image",
        "file": file,
        "width": width,
        "height": height,
        "levels": _LEVELS,
        "step": coded.step,
        "unit": 0.5 / _STEPS,
        "least": _LEAST,
        "largest": int(np.ceil(2 * _STEPS * _code(_LARGEST))),
        "columns": 2 * len(columns),
        "lamps": [
            {"column": columns.get(name, -1), **each}
            for name, each in _lamps(lit, gain, rendered).items()
        ],
        "initial": {
            "stops": round(zero - ev, 3),
            "balance": photo.white_balance,
            "view": photo.view,
            "bloom": photo.bloom,
        },
        "automatic": _adaptation(PhotoSettings(), metered),
        "automatic_kelvin": None if automatic is None else automatic.temperature,
        "temperatures": _temperatures(),
        "most": MOST,
        "filter": FILTER,
        "bloom_widths": BLOOM,
        "arrays": described,
        "block": block,
    }
    title = f"{content['title']} - lumitree"
    return web_page(title, page_file("dimmers.html"), content, _SHADERS, _SCRIPTS)


def _temperatures() -> Json:
    """Colours of black bodies, and the adaptation to each as white."""
    whites = [PhotoSettings(white_balance=float(each)) for each in _TEMPERATURES]
    adaptations = [_adaptation(each, np.ones((1, 1, 3))) for each in whites]
    return {
        "lowest": MIN_TEMPERATURE,
        "highest": MAX_TEMPERATURE,
        "colours": [_rounded(np.array(blackbody_colour(each))) for each in _TEMPERATURES],
        "adaptations": adaptations,
    }


def _adaptation(settings: PhotoSettings, metered: NDArray[np.floating]) -> list[float]:
    """Matrix of white balance for WebGL, column by column."""
    white = settings.white(metered)
    return _rounded((np.eye(3) if white is None else white.adaptation()).T.ravel())


@dataclasses.dataclass(frozen=True)
class CodedLayers:
    """Codes of an image and its layers.

    Attributes:
        arrays: uint8 [planes, pixels], "low" and "high" bytes of the coefficients of each plane,
            as 2 c for c >= 0 and -2 c - 1 for c < 0: green, red less green and blue less green of
            the sum, and of each layer; coarse levels come first.
        step: by which the finest coefficients of layers were divided; twice for red and blue.
    """

    arrays: Arrays
    step: int


def coded_layers(layers: list[NDArray[np.float32]], white: float) -> CodedLayers:
    """Codes of layers [H, W, 3], W/(m² sr), with a radiance of white."""
    total = np.round(_STEPS * _code(np.sum(layers, axis=0, dtype=np.float64) / white))
    whole = [_bands(plane) for plane in _differences(total.astype(np.int32))]
    planes = [band for bands in whole for band in bands]
    most = total[..., 0].size * (_BYTES + _BYTES_OF_LAYER * len(layers)) / _OVER_ENTROPY
    step, divided = _fitted(layers, white, most - _entropy(planes))
    codes = np.concatenate([band.ravel() for band in [*planes, *divided]])
    codes = ((codes << 1) ^ (codes >> 31)).reshape(3 * (len(layers) + 1), -1)
    low, high = (codes & 255).astype(np.uint8), (codes >> 8).astype(np.uint8)
    return CodedLayers({"low": low, "high": high}, step)


def _fitted(
    layers: Sequence[NDArray[np.float32]], white: float, most: float
) -> tuple[int, list[NDArray[np.int32]]]:
    """The smallest step for which layers have at most so many bytes, and their divided bands.

    Where even the largest step needs more, the layers are noisy, and their shares of the sum are
    filtered. The logarithm of a mean is not the mean of logarithms, so larger steps would
    change the brightness of noisy layers.
    """
    step, divided = 0, []
    for deviation in _DEVIATIONS:
        parts = []
        for layer, over in _filtered(layers, white, deviation):
            codes = np.round(2 * _STEPS * (_code(layer / white) - over))
            parts.append([_bands(plane) for plane in _differences(codes.astype(np.int32))])
        for step in _LAYER_STEPS:
            divided = [
                band
                for planes in parts
                for bands, of_plane in zip(planes, (step, 2 * step, 2 * step), strict=True)
                for band in _divided(bands, of_plane)
            ]
            if _entropy(divided) < most:
                return step, divided
    return step, divided


def _filtered(
    layers: Sequence[NDArray[np.float32]], white: float, deviation: float
) -> Iterator[tuple[NDArray[np.float32], NDArray[np.float64]]]:
    """Each layer as a share of a radiance, and u of this radiance.

    It is the sum of the layers, or a mean of it; the page scales it to the sum.

    Args:
        deviation: of the filter of noise, pixels; or 0.
    """
    total = np.sum(layers, axis=0, dtype=np.float32)
    code = np.round(_STEPS * _code(total / white)) / _STEPS
    if not deviation:
        yield from ((layer, code) for layer in layers)
        return
    # Else an emitter would be seen in the layers of other lamps. Single bright pixels are noise.
    kept = median_filter(total.max(axis=-1, keepdims=True), (5, 5, 1)) < _EMITTER * white
    window = (deviation, deviation, 0)
    code = np.where(kept, _code(gaussian_filter(kept * total, window) / white), code)
    for layer in layers:
        yield np.where(kept, gaussian_filter(kept * layer, window), layer), code


def _code(radiance: ArrayLike) -> NDArray[np.floating]:
    """u of radiance relative to white."""
    return np.log2(1 + np.minimum(np.asarray(radiance), _LARGEST) / _LEAST)


def _differences(codes: NDArray[np.int32]) -> Iterator[NDArray[np.int32]]:
    """Planes [H, W] of green, and of red and blue less green."""
    green = codes[..., 1]
    return iter((green, codes[..., 0] - green, codes[..., 2] - green))


def _bands(plane: NDArray[np.int32]) -> list[NDArray[np.int32]]:
    """Coefficients of a plane [H, W], the coarsest first; three bands a level."""
    bands: list[NDArray[np.int32]] = []
    for _ in range(_LEVELS):
        plane = _lifted(_lifted(plane).T).T
        bands = [plane[1::2, ::2], plane[::2, 1::2], plane[1::2, 1::2], *bands]
        plane = plane[::2, ::2]
    return [plane, *bands]


def _lifted(lines: NDArray[np.int32]) -> NDArray[np.int32]:
    """Differences of odd lines from their neighbours, and means of them at even ones."""
    lines = lines.copy()
    if len(lines) > 1:
        sides = np.pad(lines, ((1, 1), (0, 0)), "reflect")
        lines[1::2] -= (sides[:-2] + sides[2:])[1::2] >> 1
        sides = np.pad(lines, ((1, 1), (0, 0)), "reflect")
        lines[::2] += ((sides[:-2] + sides[2:])[::2] + 2) >> 2
    return lines


def _divided(bands: list[NDArray[np.int32]], step: int) -> list[NDArray[np.int32]]:
    """Bands divided by the step of each, and rounded; small coefficients become 0."""
    divided = [bands[0]]
    for index, band in enumerate(bands[1:]):
        of_level = max(1, step >> (_LEVELS - 1 - index // 3))
        size = np.floor(np.abs(band) / of_level + (1 - _DEAD)).astype(np.int32)
        divided.append(np.sign(band) * size if of_level > 1 else band)
    return divided


def _entropy(bands: list[NDArray[np.int32]]) -> float:
    """Bytes of bands whose values are independent, each with a code of its own."""
    total = 0.0
    for band in bands:
        counts = np.bincount((band - band.min(initial=0)).ravel())
        counts = counts[counts > 0]
        total -= float((counts * np.log2(counts / band.size)).sum()) / 8
    return total


def _seen(
    layers: Mapping[str, NDArray[np.float32]], highlights: Mapping[str, Highlights], white: float
) -> tuple[NDArray[np.uint16], dict[str, int]]:
    """Two columns for each layer with highlights, and the first column of each layer.

    The share of the light that is seen, over 65535; and 512 (log2 radiance + 64), of the
    emitter's radiance relative to white.
    """
    found, columns = [], {}
    for name in [name for name in layers if name in highlights]:
        light, of_layer = layers[name].mean(axis=-1), highlights[name]
        grey = np.maximum(of_layer.seen.mean(axis=-1), 0)
        share = np.divide(grey, light, out=np.zeros_like(grey), where=light > 0)
        level = np.divide(of_layer.square, grey * white, out=np.zeros_like(grey), where=grey > 0)
        logarithm = np.log2(np.maximum(level, 2.0**-63))
        columns[name] = len(found)
        found += [np.minimum(share, 1) * 65535, np.clip(512 * (logarithm + 64), 0, 65535)]
    flat = np.stack([np.round(each).ravel() for each in found], axis=-1)
    # Emitters that are not seen have no radiance.
    flat[:, 1::2] *= flat[:, ::2] > 0
    return flat.astype(np.uint16), columns


def _lamps(
    layers: Mapping[str, NDArray[np.float32]],
    gain: Mapping[str, tuple[float, float, float]],
    rendered: str | None,
) -> dict[str, Json]:
    """By layer: its colour, the gain at the beginning, and its placement."""
    placements = _placements(rendered)
    found = {}
    for name, light in layers.items():
        placement = placements.get(name, {})
        # The flux is known of baked lamps, else the colour is taken from what the layer shows.
        if (watts := placement.pop("watts", None)) is not None:
            colour = np.array(watts)
        else:
            xyz = light_on_scene(light)
            colour = np.ones(3) if xyz is None else np.maximum(srgb_from_xyz(xyz), 0)
        colour = np.maximum(colour / (colour @ LUMA), 1e-3)
        factors = np.array(gain.get(name, (1, 1, 1)))
        level = float(factors @ (colour * LUMA) / (colour @ LUMA))
        shown = factors / level if level else np.ones(3)
        kelvin = colour_temperature(shown * colour)[0]
        found[name] = {
            "name": name,
            "colour": _rounded(colour),
            "level": level,
            "tint": shown.tolist(),
            "own": None if np.isnan(kelvin) else kelvin,
            "factors": check_gain(placement.pop("gain", 1.0)),
            "placement": _table(name, placement),
        }
    return found


def _placements(rendered: str | None) -> dict[str, Any]:
    """Placements by layer in the settings of an image; none if another program wrote them."""
    try:
        lamps = json.loads(rendered or "{}")["lamps"]
        return {name: dict(lamp) for name, lamp in lamps.items()}
    except (ValueError, KeyError, TypeError, AttributeError):
        return {}


def _table(name: str, described: Mapping[str, Any]) -> str | None:
    """A placement as the table of a TOML file, without its gain; None for other light."""
    options: dict[str, Any] = {}
    for key in ("at", "size", "rotate", "lumens", "temperature"):
        if (value := described.get(key)) is not None:
            options[key] = tuple(value) if isinstance(value, list) else value
    try:
        placement = Placement(described["source"], **options, label=name)
        table = placements_toml([placement], ".")
    except (LumitreeError, KeyError, TypeError):
        return None
    return table if placement.is_baked else f"{table}# An explicit lamp has no gain: bake it.\n"


def _rounded(values: NDArray[np.float64]) -> list[float]:
    return [float(f"{each:.6g}") for each in values]
