"""Measurement of the light that leaves a luminaire or an asset: intensity by direction, and flux.

Rays come in independent batches of equal size, large ones in pieces (`lumitree.measure.batches`).
The intensities and the flux of an asset's light field are sums over its cells, and a photometric
file states its own: `ExactLight`, without noise. Rays then serve for the rest.
"""

import dataclasses
import functools
import math
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.asset.asset import Asset, EmittedSpectrum
from lumitree.core.frames import LocalFrame, similarity
from lumitree.core.octahedral import interpolated
from lumitree.core.photometry import RGB, luminance
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.formats.light_field import bake_distribution, opening_frame
from lumitree.formats.opening import Opening, opening_around
from lumitree.formats.tm25 import Rays
from lumitree.formats.type_c import (
    EDGE,
    MIN_STEP,
    Grid,
    IntensityDistribution,
    direction_of,
    node_solid_angles,
    y_up,
)
from lumitree.lamp.luminaire import Luminaire
from lumitree.measure.batches import BATCHES, RayBatches
from lumitree.measure.near_field import NearFieldTest
from lumitree.rendering.asset_flux import AssetRays, asset_watts, intensity_by_bin
from lumitree.trace.flux import check_output, emitted_spectrum
from lumitree.trace.light_paths import EmittedRays, LampRays, RayBatch

Up = Literal["y", "z"]
# Samples that are traced at once.
MAX_AT_ONCE = 1 << 20
# Steps that are tried, degrees, finest first; the first whose noise is low enough is taken.
STEPS = (1.0, 2.5, 5.0, 10.0)
MAX_NOISE = 0.02
# A coarse step at which the direction of the largest intensity is found before the measurement.
_COARSE_STEP = 10.0
# Most and fewest rays that the luminous opening is found by; with fewer it is the bounding box. Its
# least size in the inverse-square test, over the size of the bounding box.
_OPENING_RAYS, _MIN_RAYS, _MIN_SIZE = 1 << 14, 1 << 8, 1e-3
# Steps of a grid of exact light: tried for the angles of a file, coarsest first; and for other
# light, degrees.
_FILE_STEPS, _STEP = (10.0, 5.0, 2.5, 1.0, MIN_STEP), 1.0
# Error of the flux at which the angles of a file that are on a grid are all that it has.
_FLUX_ERROR = 1e-3
# Error of intensities between nodes of a grid, over the largest, at which it is fine enough; and
# the part of the light that may have a larger one, at the edges of beams.
_MAX_ERROR, _EDGE_LIGHT = 0.0025, 0.002


@dataclasses.dataclass(frozen=True)
class ExactLight:
    """Light of an asset as far as it is known without rays; local units.

    Attributes:
        intensity: function of local unit directions [N, 3]: luminous intensity [N].
        watts: [3] radiant flux of R, G and B.
        bin_width: mean width of the bins of direction in which light paths were counted, degrees;
            None for other light.
        angles: C and γ of the intensities of a photometric file, degrees; None for other light.
    """

    intensity: Callable[[NDArray[np.float64]], NDArray[np.float64]]
    watts: NDArray[np.float64]
    bin_width: float | None
    angles: tuple[NDArray[np.float64], NDArray[np.float64]] | None = None


@dataclasses.dataclass(frozen=True)
class Source:
    """The luminaire that is measured.

    Attributes:
        frame: its local frame; the world has y up, and lengths in metres.
        bare_flux: function of a number of samples and a seed: flux [3] of the bare emitters of the
            rays of that draw, local units; None if it is not known.
        spectrum: of the bare emitters; None if it is not known.
        exact: light that is known without rays; None if none is.
        opening: luminous opening in the middle of the box; None to find it by the origins of rays.
        check: `check_output` of a luminaire; None for an asset.
    """

    name: str
    frame: LocalFrame
    rays: EmittedRays
    bare_flux: Callable[[int, int], NDArray[np.float64]] | None = None
    spectrum: EmittedSpectrum | None = None
    exact: ExactLight | None = None
    opening: Opening | None = None
    check: Callable[[NDArray[np.float64], int], None] | None = None


def oriented(source: Source, unit: float, up: Up) -> Source:
    """The source with lengths in metres and y up; near the origin, if it is far from it.

    Intensities do not depend on its place. A ray file has float32 coordinates.

    Args:
        unit: metres in a unit of length of the luminaire's file.
        up: upward axis of that file.
    """
    turn = y_up(np.eye(3)).T if up == "z" else np.eye(3)
    frame = source.frame
    matrix = similarity(turn, unit) @ frame.world_from_local
    turned = LocalFrame(frame.half_extents, matrix)
    moved = turned.moved(-turned.centre) if turned.is_far else turned
    return dataclasses.replace(source, frame=moved)


def luminaire_source(luminaire: Luminaire) -> Source:
    """Light paths of a luminaire."""
    rays = LampRays(luminaire)
    spectrum = emitted_spectrum(luminaire)
    check = functools.partial(check_output, luminaire)
    frame = luminaire.frame
    return Source(luminaire.name, frame, rays, rays.bare_flux, spectrum, check=check)


def asset_source(asset: Asset, file: IntensityDistribution | None = None) -> Source:
    """Rays sampled from the emission of an asset: of its light field if it has one.

    Args:
        file: the photometric file that it was made of, whose intensities are then taken.
    """
    if file is None:
        exact = light_field_light(asset)
    else:
        exact = file_light(file, asset.frame, asset_watts(asset))
    opening = None if file is None else file.opening
    if opening is None and asset.is_photometric and asset.geometry is None:
        x, y, z = asset.frame.size.tolist()
        opening = Opening((x, y, z))
    return Source(
        asset.luminaire,
        asset.frame,
        AssetRays(asset),
        spectrum=asset.spectrum,
        exact=exact,
        opening=opening,
    )


def file_source(file: IntensityDistribution, colour: RGB) -> Source:
    """Light of a photometric file; its asset is made only if rays are drawn.

    Args:
        file: not of a GLDF file, whose light is not one distribution.
        colour: linear RGB of its light, of luminance 1.
    """
    frame = opening_frame(file.opening)
    exact = file_light(file, frame, colour)
    return Source(file.name, frame, _FileRays(file, colour), exact=exact, opening=file.opening)


class _FileRays:
    """Rays of the asset of a photometric file; `EmittedRays`."""

    def __init__(self, file: IntensityDistribution, colour: RGB) -> None:
        self._file, self._colour = file, colour

    @functools.cached_property
    def _rays(self) -> AssetRays:
        return AssetRays(bake_distribution(self._file, self._colour))

    def draw(self, count: int, seed: int) -> RayBatch:
        """As `EmittedRays.draw`."""
        return self._rays.draw(count, seed)


@dataclasses.dataclass(frozen=True, eq=False)
class Measurement:
    """Estimates of each batch of rays.

    Attributes:
        name: of the luminaire.
        grid: of the intensities.
        intensity: [B, C, G] luminous intensity, cd.
        watts: [B, 3] radiant flux of R, G and B, W.
        upward: [B] luminous flux above the horizontal, lm.
        emitted: [B, 3] radiant flux of the bare emitters, W; None if it is not known.
        near_field: inverse-square test of these rays; None without any.
        size: [3] sides of the bounding box, m.
        opening: luminous opening.
        centre: [3] of the opening, from the centre of the bounding box, m.
        num_rays: number of samples.
        rays: rays that were kept.
        spectrum: of the bare emitters; None if it is not known.
    """

    name: str
    grid: Grid
    intensity: NDArray[np.float64]
    watts: NDArray[np.float64]
    upward: NDArray[np.float64]
    emitted: NDArray[np.float64] | None
    near_field: NearFieldTest | None
    size: NDArray[np.float64]
    opening: Opening
    centre: NDArray[np.float64]
    num_rays: int
    rays: Rays
    spectrum: EmittedSpectrum | None


def measure(
    source: Source, num_rays: int, *, step: float | None = None, kept_rays: int = 0, seed: int = 0
) -> Measurement:
    """Measure the light that leaves a luminaire.

    Args:
        num_rays: light paths, or rays of an asset; rounded up to a multiple of 16. 0 for exact
            light: without the inverse-square test, and an opening that is not known is the box.
        step: of the angles, degrees; by default the finest of `STEPS` whose noise, the relative
            root mean square error of the intensity, is at most 2 %, as estimated from one batch;
            for exact light as `exact_grid`.
        kept_rays: about how many samples to keep the rays of; their flux is the whole flux.
        seed: root seed.

    Raises:
        LumitreeError: no light leaves the luminaire, or the flux of a path or of the bare emitters
            is NaN or infinite.
    """
    pieces = RayBatches(
        source.rays,
        num_rays,
        lambda batch, piece: SeedStream(Purpose.PHOTOMETRY, batch, piece),
        seed,
        pieces=max(1, -(-num_rays // (BATCHES * MAX_AT_ONCE))),
    )
    kept_pieces = min(pieces.count, -(-kept_rays // max(pieces.size, 1)))
    kept: list[Rays] = []
    tally = None if num_rays else _Tally(source, Rays.joined([]), pieces.count, step)
    with progress(f"light of {source.name}", pieces.count) as advance:
        for batch, drawn in pieces if num_rays else ():
            rays = _in_world(drawn, source.frame)
            if tally is None:
                tally = _Tally(source, rays, pieces.count, step)
            tally.add(batch, rays)
            if len(kept) < kept_pieces:
                kept.append(rays)
            advance(1)
    assert tally is not None
    if source.check is not None:
        source.check(luminance(tally.watts) / source.frame.scale**2, seed)
    elif not tally.watts.any():
        raise LumitreeError(f"no light leaves {source.name}")
    return Measurement(
        name=source.name,
        grid=tally.grid,
        intensity=tally.intensity,
        watts=tally.watts,
        upward=tally.upward,
        emitted=_bare_watts(source, pieces),
        near_field=tally.near_field if num_rays else None,
        size=np.abs(source.frame.rotation) @ source.frame.size,
        opening=tally.opening,
        centre=tally.centre - source.frame.centre,
        num_rays=pieces.count * pieces.size,
        rays=Rays.joined(kept),
        spectrum=source.spectrum,
    )


def _in_world(rays: RayBatch, frame: LocalFrame) -> Rays:
    """Rays of a draw in the frame of the luminaire's file; flux in W."""
    origin, direction, flux = rays.arrays()
    return Rays(
        origin @ frame.rotation.T * frame.scale + frame.centre,
        direction @ frame.rotation.T,
        flux * frame.scale**2,
    )


def _bare_watts(source: Source, pieces: RayBatches) -> NDArray[np.float64] | None:
    """Radiant flux [B, 3] of the bare emitters, W; None if it is not known."""
    if source.bare_flux is None:
        return None
    parts = [source.bare_flux(pieces.size, pieces.seed(index)) for index in range(pieces.count)]
    if not np.isfinite(parts).all():
        raise LumitreeError(
            f"the flux of the bare emitters of {source.name} is NaN or infinite; look for an "
            "emitter whose radiance is"
        )
    return (np.array(parts) * source.frame.scale**2).reshape(-1, BATCHES, 3).mean(axis=0)


class _Tally:
    """Sums over the rays of each batch; members as of `Measurement`.

    Args:
        first: rays of the first piece, by which the step is chosen and the opening is found.
        step: of the grid; None to choose it.
    """

    def __init__(self, source: Source, first: Rays, pieces: int, step: float | None) -> None:
        lumens = luminance(first.flux)
        self._share = BATCHES / pieces
        self.watts, self.upward = np.zeros((BATCHES, 3)), np.zeros(BATCHES)
        self._exact = source.exact is not None
        if source.exact is None:
            step = chosen_step(first.direction, lumens, pieces) if step is None else step
            self.grid = Grid(step)
            self.intensity = np.zeros((BATCHES, len(self.grid.c), len(self.grid.gamma)))
        else:
            self.grid, intensity = exact_grid(source.exact, source.frame, step)
            self.intensity = np.repeat(intensity[None], BATCHES, axis=0)
            self.watts += source.exact.watts * source.frame.scale**2
            self.upward += luminance(self.watts) * upward_share(source.exact, source.frame)
        x, y, z = source.frame.size.tolist()
        size, self.centre = max(x, y, z), source.frame.centre
        self.opening = source.opening or Opening((x, y, z))
        used = np.flatnonzero(lumens)[:_OPENING_RAYS]
        if source.opening is None and len(used) >= _MIN_RAYS:
            self.opening, self.centre = opening_around(first.origin[used], lumens[used])
            size = max(*self.opening.sides, _MIN_SIZE * size)
        self.near_field = NearFieldTest(size, _brightest(first.direction, lumens), BATCHES)

    def add(self, batch: int, rays: Rays) -> None:
        """Add the rays of a piece to its batch."""
        flux = rays.flux * self._share
        lumens = luminance(flux)
        if not self._exact:
            self.intensity[batch] += self.grid.intensity(rays.direction, lumens)
            self.watts[batch] += flux.sum(axis=0)
            self.upward[batch] += lumens[rays.direction[:, 1] > 0].sum()
        self.near_field.add(batch, rays.origin - self.centre, rays.direction, lumens)


def chosen_step(direction: NDArray[np.float64], lumens: NDArray[np.float64], pieces: int) -> float:
    """Finest of `STEPS` with noise of at most `MAX_NOISE` in `pieces` such as these rays."""
    for step in STEPS:
        grid = Grid(step)
        variance = grid.variance(direction, lumens)
        # The variance is the part of the squared intensity that is not signal.
        square = np.maximum(grid.intensity(direction, lumens) ** 2 - variance, 0)
        weights = np.sin(np.deg2rad(grid.gamma))
        signal, noise = ((values * weights).sum() for values in (square, variance / pieces))
        if 0 < noise <= MAX_NOISE**2 * signal:
            return step
    return STEPS[-1]


def _brightest(direction: NDArray[np.float64], lumens: NDArray[np.float64]) -> tuple[float, float]:
    """Angles C and γ of the largest intensity on a coarse grid."""
    grid = Grid(_COARSE_STEP)
    intensity = grid.intensity(direction, lumens)
    plane, row = np.unravel_index(intensity.argmax(), intensity.shape)
    return float(grid.c[plane]), float(grid.gamma[row])


def light_field_light(asset: Asset) -> ExactLight | None:
    """The light of an asset's light field; None if it has none."""
    if asset.light_field is None:
        return None
    by_bin, watts = intensity_by_bin(asset), asset_watts(asset) / asset.frame.scale**2
    traced = asset.light_field.traced is not None
    width = math.degrees(math.sqrt(4 * math.pi / len(by_bin))) if traced else None
    return ExactLight(lambda direction: interpolated(by_bin, direction), watts, width)


def file_light(
    distribution: IntensityDistribution, frame: LocalFrame, colour: ArrayLike = (1.0, 1.0, 1.0)
) -> ExactLight:
    """The light of a photometric file, whose asset has this frame.

    The bins of the asset change intensities, so a file is converted without them.

    Args:
        colour: linear RGB of its light, of any luminance.
    """
    scale = frame.scale**2
    rgb = np.asarray(colour, np.float64)
    return ExactLight(
        lambda direction: distribution.at(direction @ frame.rotation.T) / scale,
        rgb * (distribution.lumens / float(luminance(rgb)) / scale),
        None,
        (distribution.c, distribution.gamma),
    )


def exact_grid(
    light: ExactLight, frame: LocalFrame, step: float | None
) -> tuple[Grid, NDArray[np.float64]]:
    """A grid, and intensities [C, G] of light without noise, cd.

    Where the angles of a file are on the grid, its own intensities are taken. Else they are means
    over the hats of nodes, as of rays: the intensities at the nodes of a finer grid, of 0.5 degrees
    or less, and linear between them.

    Args:
        step: of the grid, degrees. None to choose it: for a file the coarsest of 10, 5, 2.5, 1 and
            0.5 that has all of its angles; for light in bins the coarsest of these that is at most
            half a bin, since finer ones show only the kinks between bins; else 1, or 0.5 if 1 does
            not resolve the light.
    """
    if step is None and light.bin_width is not None:
        step = next((each for each in _FILE_STEPS if each <= light.bin_width / 2), MIN_STEP)
    parts = 1 if step is None else math.ceil(step / MIN_STEP)
    fine = (MIN_STEP if step is None else step) / parts
    c = fine * np.arange(round(360 / fine), dtype=np.float64)
    gamma = fine * np.arange(round(180 / fine) + 1, dtype=np.float64)

    def candela(c: NDArray[np.float64], gamma: NDArray[np.float64]) -> NDArray[np.float64]:
        directions = direction_of(c[:, None], gamma).reshape(-1, 3)
        values = light.intensity(directions @ frame.rotation) * frame.scale**2
        return values.reshape(len(c), -1)

    directions, values = direction_of(c[:, None], gamma).reshape(-1, 3), candela(c, gamma).ravel()
    flux = values * node_solid_angles(c, gamma).ravel()

    def resolves(found: IntensityDistribution) -> bool:
        wrong = np.abs(found.at(directions) - values) > _MAX_ERROR * values.max()
        return flux[wrong].sum() <= _EDGE_LIGHT * flux.sum()

    lumens = float(luminance(light.watts)) * frame.scale**2
    for each in () if light.angles is None else _FILE_STEPS if step is None else (step,):
        grid = Grid(each)
        if all(_on_grid(angles, each) for angles in light.angles or ()):
            found = IntensityDistribution("", grid.c, grid.gamma, candela(grid.c, grid.gamma))
            if resolves(found) and abs(found.lumens - lumens) <= _FLUX_ERROR * lumens:
                return grid, found.intensity
    grid = Grid(_STEP if step is None else step)
    found = IntensityDistribution("", grid.c, grid.gamma, grid.intensity(directions, flux))
    if step is None and not resolves(found):
        grid = Grid(MIN_STEP)
        return grid, grid.intensity(directions, flux)
    return grid, found.intensity


def _on_grid(angles: NDArray[np.float64], step: float) -> bool:
    """Whether angles are multiples of a step, but for the edges beside an angle with light."""
    on = np.abs(angles / step - np.round(angles / step)) * step < 1e-6
    if not on.any():
        return False
    return bool((np.abs(angles[:, None] - angles[on]).min(axis=1) <= 2 * EDGE).all())


def upward_share(light: ExactLight, frame: LocalFrame) -> float:
    """Part of the flux of light that goes up, +y of the file, 0 to 1."""
    step = MIN_STEP / 2
    # Between the angles of files, at which intensities may have steps.
    c = np.arange(MIN_STEP, 360, 2 * MIN_STEP)
    gamma = np.arange(step / 2, 180, step)
    direction = direction_of(c[:, None], gamma).reshape(-1, 3)
    intensity = light.intensity(direction @ frame.rotation).reshape(len(c), -1).mean(axis=0)
    flux = intensity * np.sin(np.deg2rad(gamma))
    up, down = float(flux[gamma > 90].sum()), float(flux[gamma < 90].sum())
    return up / (up + down) if up > 0 else 0.0
