"""Glare: Unified Glare Rating (CIE 117) of images and of lamps, Daylight Glare Probability."""

import dataclasses
import math
import warnings
from collections.abc import Sequence
from typing import TYPE_CHECKING, Any, cast

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import label

from lumitree.core.arguments import check_items, metres_of
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.frames import similarity_scale
from lumitree.core.photometry import luminance
from lumitree.core.progress import reporting
from lumitree.errors import LumitreeError, LumitreeWarning, explained
from lumitree.formats.type_c import IntensityDistribution
from lumitree.lamp.source import LuminaireSource, source_kind
from lumitree.rendering.placement import Placement
from lumitree.rendering.render import RenderResult

if TYPE_CHECKING:
    from lumitree.rendering.scene import CameraView, PlacedLuminaire

# Brighter pixels are sources: for the UGR in mean luminances of the others, for the DGP in cd/m².
_BRIGHT = 5
_BRIGHT_DAYLIGHT = 2000.0
# A larger difference between the ratings of the image and of half its resolution is warned of.
_TOLERANCE = 1.0
# Light paths of a lamp whose intensities are not known, and area of a lamp without one, m².
_RAYS, _POINT_AREA = 1 << 18, 1e-4


@dataclasses.dataclass(frozen=True)
class Glare:
    """Glare of a view.

    Attributes:
        ugr: Unified Glare Rating (CIE 117), of the sources in the image: from 10, not perceptible,
            to 28, intolerable. Pixels brighter than 5 times the mean luminance of the rest of the
            image are sources. NaN without a source, with sources of single pixels only, and before
            a black background.
        dgp: Daylight Glare Probability, 0 to 1, of sources above 2,000 cd/m²; it holds for
            daylight, and for a vertical illuminance above 380 lx.
        vertical_illuminance: at the eye, lx.
        background: luminance of the image without its sources, cd/m²: the mean, weighted by the
            cosine of the angle to the line of sight, as the indirect illuminance of CIE 117 is.
        source_luminance: mean luminance of the sources, cd/m²; NaN without a source.
        source_solid_angle: their solid angle, sr.
    """

    ugr: float
    dgp: float
    vertical_illuminance: float
    background: float
    source_luminance: float
    source_solid_angle: float


@explained
def glare(image: RenderResult, vertical_illuminance: float) -> Glare:
    """Glare of a rendered view.

    UGR = 8 log₁₀(0.25 / L_b · Σ L² ω / p²), over the pixels of sources with luminance L and solid
    angle ω. A source is a connected part of the image, and p the position index of its centre, by
    Guth, and below the line of sight by Iwata and Tokura. Every pixel counts with its own
    luminance, so a bright spot of a lamp is not averaged over the lamp.

    Apart from the vertical illuminance, the image stands for all that the eye sees. So let it be
    wide: a source outside of it does not count. Sources should be 6 pixels wide or more. A warning
    says that the image at half its resolution has another UGR, by 1 or more.

    Args:
        image: of a perspective camera, 64 pixels wide and high or more.
        vertical_illuminance: illuminance at the camera, with its direction of view as normal, lx,
            as of `illuminance`. Without a positive number the DGP is NaN.

    Raises:
        LumitreeError: the camera has no `CameraView`, or the image is too small.
    """
    if image.camera is None:
        raise LumitreeError(
            "the camera is not a perspective one, or its axis is not at the centre of the image; "
            "glare needs both"
        )
    height, width = image.pixels.shape[:2]
    if min(height, width) < 64:
        raise LumitreeError(f"the image has {width} x {height} pixels; glare needs 64 x 64 or more")
    values = np.maximum(np.nan_to_num(luminance(image.pixels), posinf=0.0), 0)
    view = _View(values, image.camera)
    halved = values[: height // 2 * 2, : width // 2 * 2]
    halved = halved.reshape(height // 2, 2, width // 2, 2).mean((1, 3))
    ugr, coarse = view.ugr(), _View(halved, image.camera).ugr()
    source = view.source
    if source.any() and view.background and not abs(ugr - coarse) < _TOLERANCE:
        warnings.warn(
            f"the UGR is {ugr:.1f}, and {coarse:.1f} at half the resolution: sources are small or "
            "noisy; render a larger image, or one with more samples per pixel",
            LumitreeWarning,
            stacklevel=3,
        )
    omega = float(view.solid_angle[source].sum())
    known = math.isfinite(vertical_illuminance) and vertical_illuminance > 0
    return Glare(
        ugr=ugr,
        dgp=view.dgp(vertical_illuminance) if known else math.nan,
        vertical_illuminance=vertical_illuminance,
        background=view.background,
        source_luminance=float((values * view.solid_angle)[source].sum()) / (omega or math.nan),
        source_solid_angle=omega,
    )


@dataclasses.dataclass(frozen=True)
class LampGlare:
    """Glare of lamps at an observer.

    Attributes:
        ugr: Unified Glare Rating (CIE 117); NaN if no lamp is seen, or the background is black.
        luminance: of each lamp, cd/m²: its intensity towards the observer over the area of its
            luminous opening seen from there.
        solid_angle: of each opening, sr.
        position_index: of each lamp, by Guth; infinite for a lamp behind the observer.
    """

    ugr: float
    luminance: list[float]
    solid_angle: list[float]
    position_index: list[float]


@in_turn
def lamp_glare(
    placements: Sequence[Placement],
    observer: tuple[float, float, float],
    direction: tuple[float, float, float],
    background: float,
    *,
    up: tuple[float, float, float] = (0.0, 1.0, 0.0),
    unit: float | str = "m",
    variant: str | None = None,
) -> LampGlare:
    """Glare of lamps at an observer, by their intensities and not by pixels of an image.

    UGR = 8 log₁₀(0.25 / L_b · Σ L² ω / p²), over the lamps, as CIE 117 and lighting programs have
    it: a lamp is evenly bright over its luminous opening, and nothing of the room hides it. Lamps
    of the scene itself do not count. Noise of explicit lamps is below 0.2.

    Args:
        placements: the luminaires, as for `render`.
        observer: [3] the eye, scene units.
        direction: [3] line of sight, of any length.
        background: luminance L_b of the background, cd/m²: the indirect vertical illuminance at the
            eye over π.
        up: [3] direction that is up for the observer.
        unit: unit of length of the scene, as for `illuminance`.
        variant: Mitsuba variant; see `bake`.

    Returns:
        The rating, and the figures of each lamp in the order of the placements and their arrays.

    Raises:
        LumitreeError: an argument is no direction or unit; or a lamp cannot be read.

    Example:
        >>> lamp = lumitree.Placement("lamp.ies", at=(0, 2.7, -3), grid=(2, 3), pitch=(2, 2))
        >>> print(lumitree.lamp_glare([lamp], (0, 1.2, 0), (0, 0, -1), background=30).ugr)
    """
    check_items("placements", placements, Placement)
    lamps = [lamp for placement in placements for lamp in placement.each()]
    metres = metres_of(unit)
    ahead = np.asarray(direction, np.float64)
    right = np.cross(ahead, up)
    if not (np.isfinite(right).all() and np.linalg.norm(right) > 0):
        raise LumitreeError(
            f"the line of sight is {direction} and up is {up}; expected two different directions"
        )
    axes = np.stack([right, np.cross(right, ahead), ahead])
    axes /= np.linalg.norm(axes, axis=1, keepdims=True)
    load_rgb(variant)
    from lumitree.rendering.scene import open_placements

    known: dict[object, tuple[IntensityDistribution, NDArray[np.float64]]] = {}
    found = []
    for lamp in open_placements(lamps, metres):
        if lamp.source not in known:
            known[lamp.source] = _light_of(lamp, metres)
        light, centre = known[lamp.source]
        turn = lamp.scene_from_world[:3, :3]
        scale = similarity_scale(lamp.scene_from_world)
        offset = turn @ centre + lamp.scene_from_world[:3, 3] - observer
        distance = float(np.linalg.norm(offset))
        towards = -offset @ turn / (scale * distance)
        lumens = light.lumens * (scale * metres) ** 2
        if lamp.asset is not None:
            lumens = float(luminance(lamp.watts))
        candela = float(light.at(towards)) * lumens / light.lumens
        area = float(light.opening.projected_area(towards)) * (scale * metres) ** 2 or _POINT_AREA
        across, height, depth = axes @ offset
        seen = depth > 0
        index = float(_position_index(across / depth, height / depth)) if seen else math.inf
        found.append((candela / area, area / (distance * metres) ** 2, index))
    sums = sum(lit**2 * omega / index**2 for lit, omega, index in found)
    is_known = sums > 0 and background > 0
    ugr = 8 * math.log10(0.25 / background * sums) if is_known else math.nan
    lit, omega, index = map(list, zip(*found, strict=True)) if found else ([], [], [])
    return LampGlare(ugr, lit, omega, index)


def _light_of(
    lamp: "PlacedLuminaire", metres: float
) -> tuple[IntensityDistribution, NDArray[np.float64]]:
    """Intensities of a lamp in the frame of its file, and the centre [3] of its opening there."""
    from lumitree.formats.photometric_file import read_again
    from lumitree.measure.far_field import asset_source, luminaire_source, measure

    if lamp.luminaire is not None:
        source = luminaire_source(lamp.luminaire)
    else:
        assert lamp.asset is not None
        name = lamp.placement.source
        is_file = source_kind(name) == "photometric" and not isinstance(name, LuminaireSource)
        file = read_again(cast(Any, name)) if is_file else None
        source = asset_source(lamp.asset, file)
        if file is not None:
            source = dataclasses.replace(source, opening=file.opening.scaled(1 / metres))
    with reporting(None):
        found = measure(source, _RAYS)
    intensity, grid = found.intensity.mean(axis=0), found.grid
    light = IntensityDistribution(found.name, grid.c, grid.gamma, intensity, found.opening)
    return light, source.frame.centre + found.centre


class _View:
    """Luminances [H, W], cd/m², and solid angles of their pixels, sr."""

    def __init__(self, luminances: NDArray[np.float64], camera: "CameraView") -> None:
        height, width = luminances.shape
        halves = [math.tan(math.radians(each) / 2) for each in (camera.horizontal, camera.vertical)]
        # Offsets from the line of sight at a distance of 1.
        across = halves[0] * ((2 * np.arange(width) + 1) / width - 1)
        up = halves[1] * (1 - (2 * np.arange(height) + 1) / height)
        self.across, self.up = np.meshgrid(across, up)
        cosine = 1 / np.sqrt(1 + self.across**2 + self.up**2)
        self.luminances = luminances
        self.solid_angle = 4 * halves[0] * halves[1] / (height * width) * cosine**3
        self.source, count = np.zeros_like(luminances, bool), -1
        # A bright source raises the mean, and would hide others from it. Each source lowers it.
        while self.source.sum() > count:
            count = self.source.sum()
            mean = np.average(luminances, weights=self.solid_angle * ~self.source)
            self.source |= luminances > _BRIGHT * mean
        weights = self.solid_angle * cosine * ~self.source
        self.background = float(np.average(luminances, weights=weights))

    def glare(self, bright: NDArray[np.bool_]) -> float:
        """Σ L² ω / p² over the pixels that are bright.

        L² is the product of the luminances of two pixels at a distance of 1 and 2, extrapolated to
        a distance of 0. Noise of pixels does not raise it, and pixels at the edge of a source,
        which have a part of its luminance, do not lower it.
        """
        sources, count = cast("tuple[NDArray[np.int32], int]", label(bright, np.ones((3, 3))))
        flux = np.where(bright, self.luminances * self.solid_angle, 0)
        total, across, up = (
            np.bincount(sources.ravel(), (flux * each).ravel(), count + 1)
            for each in (1, self.across, self.up)
        )
        total[0] = 1
        position = _position_index(across / total, up / total)[sources]
        root = np.where(bright, self.luminances, 0) * np.sqrt(self.solid_angle) / position
        near, far = (
            (root[step:] * root[:-step]).sum() + (root[:, step:] * root[:, :-step]).sum()
            for step in (1, 2)
        )
        return max(float(near - far / 2), 0.0)

    def ugr(self) -> float:
        """Unified Glare Rating; NaN if it is not defined."""
        glare = self.glare(self.source)
        if not (glare and self.background):
            return math.nan
        return 8 * math.log10(0.25 / self.background * glare)

    def dgp(self, vertical: float) -> float:
        """Daylight Glare Probability (Wienold and Christoffersen 2006), of an illuminance, lx."""
        glare = self.glare(self.luminances > _BRIGHT_DAYLIGHT)
        value = 5.87e-5 * vertical + 0.0918 * math.log10(1 + glare / vertical**1.87) + 0.16
        return min(value, 1.0)


def _position_index(across: NDArray[np.float64], up: NDArray[np.float64]) -> NDArray[np.float64]:
    """Position index by Guth, and below the line of sight by Iwata and Tokura; at most 16.

    Offsets [N] from the line of sight are at a distance of 1.
    """
    tangent = np.hypot(across, up)
    sigma, tau = np.degrees(np.arctan(tangent)), np.degrees(np.arctan2(np.abs(across), up))
    above = np.exp(
        (35.2 - 0.31889 * tau - 1.22 * np.exp(-2 * tau / 9)) * 1e-3 * sigma
        + (21 + 0.26667 * tau - 0.002963 * tau**2) * 1e-5 * sigma**2
    )
    below = 1 + np.where(tangent > 0.6, 1.2, 0.8) * np.minimum(tangent, 3)
    return np.minimum(np.where(up < -1e-9, below, above), 16)
