"""Measurement of the light that leaves a luminaire or an asset, by rays.

Rays come in independent batches of equal size, large ones in pieces (`lumitree.measure.batches`).
The intensities and the flux of an asset's light field are sums over its cells, without noise; rays
then serve for the rest.
"""

import dataclasses
import functools
from collections.abc import Callable
from typing import Literal

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset, EmittedSpectrum
from lumitree.core.frames import LocalFrame, similarity
from lumitree.core.photometry import luminance
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.formats.opening import Opening, opening_around
from lumitree.formats.rays import Rays
from lumitree.formats.type_c import Grid, IntensityDistribution, y_up
from lumitree.lamp.luminaire import Luminaire
from lumitree.measure.batches import BATCHES, RayBatches
from lumitree.measure.photometry.exact_light import (
    ExactLight,
    exact_grid,
    file_light,
    light_field_light,
    upward_share,
)
from lumitree.measure.photometry.near_field import NearFieldTest
from lumitree.rendering.asset_flux import asset_watts
from lumitree.rendering.asset_rays import AssetRays
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
# Rays that the luminous opening is found by, at most and at least; else it is the bounding box. Its
# least size in the inverse-square test, over the size of the bounding box.
_OPENING_RAYS, _MIN_RAYS, _MIN_SIZE = 1 << 14, 1 << 8, 1e-3


@dataclasses.dataclass(frozen=True)
class Source:
    """The luminaire that is measured.

    Attributes:
        frame: its local frame; the world has y up, and lengths in metres.
        bare_flux: function of a number of samples and a seed: flux [3] of the bare emitters of the
            rays of that draw, local units; None if it is not known.
        spectrum: of the bare emitters; None if it is not known.
        exact: what is known without rays; None if nothing is.
        opening: luminous opening in the middle of the box; None to find it by where rays start.
        check: `check_output` of a luminaire; None of an asset.
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
        file: the photometric file that it was made of, whose own intensities are then taken.
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
        near_field: inverse-square test of these rays.
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
    near_field: NearFieldTest
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
        num_rays: light paths, or rays of an asset; rounded up to a multiple of 16.
        step: of the angles, degrees; by default the finest of `STEPS` whose noise, the relative
            root mean square error of the intensity, is at most 2 %, as estimated from one batch;
            without noise as of `exact_grid`.
        kept_rays: about how many samples to keep the rays of; their flux is that of all.
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
    kept_pieces = min(pieces.count, -(-kept_rays // pieces.size))
    kept: list[Rays] = []
    tally: _Tally | None = None
    with progress(f"light of {source.name}", pieces.count) as advance:
        for batch, drawn in pieces:
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
        near_field=tally.near_field,
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
        # Of the squared intensity, the variance is a part that is not signal.
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
