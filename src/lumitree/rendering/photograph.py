"""Photographs: what a camera with exposure and white balance makes of an image's radiance.

Exposure is EV100: white on the display is a luminance of 1.2 x 2^EV cd/m², as for a camera whose
sensor is rated by its saturation (ISO 12232). White balance is a chromatic adaptation by CAT16
(CIE 248:2022).

Filaments are up to 1,000 times as bright as white, and the edge of one would be a staircase
whatever the reconstruction filter. So emitters that are seen are clamped to a few times white
before pixels are averaged, as far as the mean of squares tells it, and filtered by a Gaussian.
"""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.arguments import check_choice, check_range
from lumitree.core.images import block_means
from lumitree.core.photometry import (
    LUMENS_PER_WATT,
    MAX_TEMPERATURE,
    MIN_TEMPERATURE,
    blackbody_xyz,
    luminance,
    srgb_from_xyz,
    xyz_from_srgb,
    xyz_temperature,
)
from lumitree.errors import LumitreeError, shown
from lumitree.rendering.view_transform import VIEWS, View, displayed

# Log-average luminance of the scene relative to white. Side in pixels of the blocks over which it
# is averaged: the logarithm of single pixels would measure their noise. Share of the blocks that is
# at most so many times as bright as white.
_KEY, _BLOCK, _BRIGHTEST = 0.4, 8, (0.95, 4.0)
# Stops above and below the median block beyond which a block is no part of the scene: lamps and
# windows, and openings into the dark.
_ABOVE, _BELOW = 4.0, 7.0
# cd/m² of white at EV 0, for which the image of a black scene is exposed, too.
_WHITE = 1.2
# Largest exposures, stops and EV100.
_MAX_STOPS, _MAX_EV = 40.0, 60.0
# Part of the way to daylight that automatic white balance goes, as eyes and cameras do: warm light
# stays a little warm. Beyond this Duv light is coloured on purpose; its colour stays.
_ADAPTATION, _COLOURED = 0.7, (0.02, 0.05)
# Least albedo by which the light on a surface is known; and see `light_on_scene`.
_LEAST_ALBEDO, _POWER = 0.05, 4
# Largest radiance of a photograph over white, and standard deviation of the filter of what is
# brighter, pixels.
MOST, FILTER = 16.0, 0.5
# Bloom: standard deviations of Gaussians as parts of the image's diagonal, and their weights.
BLOOM = ((0.003, 0.5), (0.012, 0.35), (0.04, 0.15))
_CAT16 = np.array(
    [
        [0.401288, 0.650173, -0.051461],
        [-0.250268, 1.204414, 0.045854],
        [-0.002079, 0.048952, 0.953127],
    ]
)
_D65, _D65_TEMPERATURE = xyz_from_srgb(np.ones(3)), 6504.0


@dataclasses.dataclass(frozen=True)
class Highlights:
    """Light of emitters that the camera sees, also by mirrors and glass.

    Attributes:
        seen: [H, W, 3], W/(m² sr).
        square: [H, W], mean over the samples of a pixel of the square of the mean of R, G and B.
    """

    seen: NDArray[np.floating]
    square: NDArray[np.floating]

    def scaled(self, factors: NDArray[np.float32]) -> "Highlights":
        """The light times factors [3] on R, G and B."""
        seen = self.seen * factors
        change = np.ones_like(self.square)
        before = self.seen.mean(axis=-1)
        np.divide(seen.mean(axis=-1), before, out=change, where=before > 0)
        return Highlights(seen, self.square * change**2)

    def divide(self, most: float) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
        """Light [H, W, 3] of emitters of more than `most`, W/(m² sr), and the same clamped.

        A pixel that an emitter covers to a share p has the mean pL and the mean square pL² of its
        radiance L. For emitters of several radiances p is the share of the brighter ones.
        """
        grey = np.asarray(self.seen, np.float32).mean(axis=-1)
        level = np.divide(self.square, grey, out=np.zeros_like(grey), where=grey > 0)
        beyond = (level > most) & np.isfinite(level)
        bright = np.where(beyond[..., None], self.seen, np.float32(0))
        clamped = bright * (most / np.maximum(level, most)).astype(np.float32)[..., None]
        return bright, clamped


@dataclasses.dataclass(frozen=True)
class Photograph:
    """An image as a display shows it.

    Attributes:
        pixels: uint8 [H, W, 3], sRGB.
        ev: exposure, EV100.
        white_balance: colour temperature that is shown as white, K; None for no adaptation.
    """

    pixels: NDArray[np.uint8]
    ev: float
    white_balance: float | None

    def described(self, settings: "PhotoSettings") -> dict[str, float | str]:
        """The settings and the values chosen by them, for the comment of an image."""
        return {
            **dataclasses.asdict(settings),
            "ev": self.ev,
            "white_balance": "off" if self.white_balance is None else self.white_balance,
        }


@dataclasses.dataclass(frozen=True, kw_only=True)
class PhotoSettings:
    """How a photograph is taken, with the options of `render`.

    Raises:
        LumitreeError: a setting is out of range.
    """

    exposure: float | str = 0.0
    white_balance: float | str = "auto"
    view: View = "agx"
    bloom: float = 0.06

    def __post_init__(self) -> None:
        check_choice("view", self.view, VIEWS)
        check_exposure(self.exposure)
        check_range("bloom", self.bloom, 0, 1)
        if self.white_balance not in ("auto", "off"):
            if isinstance(self.white_balance, str):
                raise LumitreeError(
                    f"white_balance is {shown(repr(self.white_balance), 60)}; expected auto, off "
                    "or the colour temperature of the light, K"
                )
            check_range("white_balance", self.white_balance, MIN_TEMPERATURE, MAX_TEMPERATURE, "K")

    def photograph(
        self,
        radiance: NDArray[np.floating],
        *,
        metered: NDArray[np.floating] | None = None,
        albedo: NDArray[np.floating] | None = None,
        highlights: Highlights | None = None,
    ) -> Photograph:
        """Take a photograph.

        Args:
            radiance: [H, W, 3], W/(m² sr).
            metered: [H, W, 3], radiance by which automatic exposure and white balance are chosen.
                Default: `radiance`.
            albedo: [H, W, 3] of its surfaces, which tells the colour of the light on them.
            highlights: part of `radiance`.
        """
        metered = radiance if metered is None else metered
        ev = exposure_value(self.exposure, lambda: automatic_ev(metered))
        white = self.white(metered, albedo)
        scaled = bloomed(_resolved(radiance, highlights, white_radiance(ev)), self.bloom)
        if white is not None:
            scaled = scaled @ white.adaptation().T.astype(np.float32)
        kelvin = None if white is None else white.temperature
        return Photograph(displayed(scaled, self.view), ev, kelvin)

    def white(
        self, radiance: NDArray[np.floating], albedo: NDArray[np.floating] | None = None
    ) -> "White | None":
        """The colour that becomes white, for arguments of `light_on_scene`; None for no change."""
        if self.white_balance == "off":
            return None
        if isinstance(self.white_balance, str):
            light = light_on_scene(radiance, albedo)
            return None if light is None else white_for(light)
        return White(_blackbody(self.white_balance), self.white_balance)


@dataclasses.dataclass(frozen=True)
class White:
    """Colour that a photograph shows as white.

    Attributes:
        xyz: [3], with Y = 1.
        temperature: correlated colour temperature, K.
    """

    xyz: NDArray[np.float64]
    temperature: float

    def adaptation(self) -> NDArray[np.float64]:
        """Matrix [3, 3] of linear sRGB: chromatic adaptation of this colour to D65 (CAT16)."""
        gains = (_CAT16 @ _D65) / np.maximum(_CAT16 @ self.xyz, 1e-3)
        adapted = np.linalg.solve(_CAT16, gains[:, None] * _CAT16)
        return srgb_from_xyz((adapted @ xyz_from_srgb(np.eye(3)).T).T).T


def white_for(light: NDArray[np.float64]) -> White | None:
    """The white that automatic white balance chooses for light of a colour [3], XYZ.

    It lies between daylight and the light, in reciprocal temperatures along the Planckian locus: a
    straight line between the two colours would pass through pink. None for coloured light.
    """
    temperature, duv = xyz_temperature(light)
    low, high = _COLOURED
    if math.isnan(temperature) or abs(duv) >= high:
        return None
    degree = _ADAPTATION * min((high - abs(duv)) / (high - low), 1.0)
    chosen = 1 / ((1 - degree) / _D65_TEMPERATURE + degree / temperature)
    # Distances from the locus are taken over alike.
    off_light = light / light[1] / _blackbody(temperature)
    off_daylight = _D65 / _blackbody(_D65_TEMPERATURE)
    xyz = _blackbody(chosen) * off_light**degree * off_daylight ** (1 - degree)
    return White(xyz, chosen)


def _blackbody(temperature: float) -> NDArray[np.float64]:
    """XYZ [3] of a black body, with Y = 1."""
    xyz = blackbody_xyz(np.array([temperature]))[0]
    return xyz / xyz[1]


def check_exposure(exposure: float | str) -> None:
    """Refuse an exposure that is neither stops nor EV100.

    Raises:
        LumitreeError: it is another text, or out of range.
    """
    if not isinstance(exposure, str):
        check_range("exposure", exposure, -_MAX_STOPS, _MAX_STOPS, "stops")
        return
    try:
        name, _, value = exposure.lower().partition("=")
        known = name == "ev" and -_MAX_EV <= float(value) <= _MAX_EV
    except ValueError:
        known = False
    if not known:
        raise LumitreeError(
            f"exposure is {shown(repr(exposure), 60)}; expected stops more than automatic, such as "
            f"+1, or an exposure value of -{_MAX_EV:.0f} to {_MAX_EV:.0f}, such as ev=9.5"
        )


def exposure_value(exposure: float | str, automatic: Callable[[], float]) -> float:
    """EV100 of an exposure, as for `render`; `automatic` computes EV100 where that is needed."""
    if isinstance(exposure, str):
        return float(exposure.partition("=")[2])
    return automatic() - exposure


def ev_of_white(radiance: float) -> float:
    """EV100 for which a grey radiance, W/(m² sr), is white on the display."""
    return math.log2(LUMENS_PER_WATT * radiance / _WHITE)


def white_radiance(ev: float) -> float:
    """Radiance, W/(m² sr), of grey that is white on the display at an EV100."""
    return _WHITE * 2.0**ev / LUMENS_PER_WATT


def automatic_ev(radiance: NDArray[np.floating]) -> float:
    """EV100 for an image [H, W, 3], W/(m² sr), by the log-average luminance of the scene in it.

    Lamps, windows and openings into the dark are no part of the scene.
    """
    blocks, of_scene = _scene(radiance)
    scene = luminance(blocks)[of_scene]
    if not scene.size:
        return ev_of_white(1.0)
    share, most = _BRIGHTEST
    white = max(np.exp2(np.log2(scene).mean()) / _KEY, np.quantile(scene, share) / most)
    return float(np.clip(np.log2(white / _WHITE), -_MAX_EV, _MAX_EV))


def light_on_scene(
    radiance: NDArray[np.floating], albedo: NDArray[np.floating] | None = None
) -> NDArray[np.float64] | None:
    """Colour [3], XYZ, of the light on the surfaces of an image [H, W, 3]; None for a black image.

    With the albedo [H, W, 3] of the surfaces it is radiance over albedo. Without it bright surfaces
    count most, which are mostly white.
    """
    blocks, scene = _scene(radiance)
    if albedo is not None:
        reflected = _blocks(np.asarray(albedo, np.float64))
        scene &= reflected.min(axis=-1) > _LEAST_ALBEDO
        blocks = blocks / np.maximum(reflected, _LEAST_ALBEDO)
    if not scene.any():
        return None
    # The mean of a high power is decided by bright surfaces, but not by single ones: gilt beside a
    # bulb, whose light is not the scene's.
    light, level = blocks[scene], luminance(blocks[scene])
    level = np.maximum(level, np.quantile(level, _BRIGHTEST[0]))[:, None]
    return xyz_from_srgb(((light / level) ** _POWER).mean(axis=0) ** (1 / _POWER))


def bloomed(image: NDArray[np.float32], share: float) -> NDArray[np.float32]:
    """An image [H, W, 3] of which a share of the light is scattered, as in a lens or an eye.

    Light that would leave the image is reflected at its edges, so that none is lost.
    """
    if not share:
        return image
    height, width = image.shape[:2]
    diagonal = math.hypot(height, width)
    squares = np.add.outer((np.arange(height) / height) ** 2, (np.arange(width) / width) ** 2)
    squares = squares.astype(np.float32)
    kept = np.full((height, width), 1 - share, np.float32)
    for deviation, weight in BLOOM:
        kept += share * weight * np.exp(-0.5 * (np.pi * deviation * diagonal) ** 2 * squares)
    from scipy import fft

    spectrum: Any = fft.dctn(image, axes=(0, 1), norm="ortho")
    shown: Any = fft.idctn(spectrum * kept[..., None], axes=(0, 1), norm="ortho")
    return np.maximum(shown, 0)


def _resolved(
    radiance: NDArray[np.floating], highlights: Highlights | None, white: float
) -> NDArray[np.float32]:
    """Radiance relative to white, clamped to a few times white; see the docstring of the module."""
    image = np.nan_to_num(radiance / white, posinf=MOST, neginf=0.0).astype(np.float32)
    if highlights is not None:
        bright, clamped = highlights.divide(MOST * white)
        if bright.any():
            from scipy.ndimage import gaussian_filter

            filtered = gaussian_filter(clamped, (FILTER, FILTER, 0), mode="nearest")
            image += (filtered - bright) / white
    image = np.maximum(image, 0)
    return image * (MOST / np.maximum(image.max(axis=-1, keepdims=True), MOST))


def _scene(radiance: NDArray[np.floating]) -> tuple[NDArray[np.float64], NDArray[np.bool_]]:
    """Blocks of an image, and which of them are of the scene."""
    finite = np.nan_to_num(np.asarray(radiance, np.float64), nan=0.0, posinf=0.0, neginf=0.0)
    blocks = _blocks(finite)
    return blocks, _of_scene(luminance(blocks))


def _blocks(pixels: NDArray[np.float64]) -> NDArray[np.float64]:
    """Means over blocks, of each channel."""
    return np.stack([block_means(pixels[..., i], _BLOCK) for i in range(3)], axis=-1)


def _of_scene(means: NDArray[np.float64]) -> NDArray[np.bool_]:
    """Which blocks, by their mean luminance, are of the scene."""
    lit = means > 0
    if not lit.any():
        return lit
    stops = np.log2(np.where(lit, means, 1.0))
    middle = np.median(stops[lit])
    return lit & (stops < middle + _ABOVE) & (stops > middle - _BELOW)
