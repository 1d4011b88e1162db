"""Irradiance around a luminaire, by light that leaves it: what a room receives.

A cube three times the size of the luminaire's bounding box stands around it, in its local frame. A
seventh square touches the lower side of the bounding box, as a table below a lamp might. Each
square is divided into patches. Rays that leave the luminaire carry flux straight to the patches.
Where the rays come from does not matter, so every representation of a luminaire from which emitted
rays can be sampled is compared in the same way.

Symbols
    E       irradiance of a patch, R, G and B: flux of the rays that reach it over its area, in the
            luminaire's units of radiance times sr
"""

import dataclasses
import math
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.asset.asset import Asset
from lumitree.core.photometry import luminance
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.lamp.luminaire import Luminaire
from lumitree.measure.batches import RayBatches, jackknife
from lumitree.rendering.asset_rays import AssetRays
from lumitree.trace.cameras import PATH_DEPTH
from lumitree.trace.light_paths import EmittedRays, LampRays, RayBatch

FACES = ("-x", "+x", "-y", "+y", "-z", "+z", "touching")
# The first faces are the faces of the cube.
NUM_CUBE_FACES = 6
# Half side of the cube, local units, and patches along a side of each square.
CUBE_HALF_SIDE = 3.0
PATCHES = 12
# The RMS difference of a face is defined if at least this part of the reference's mean square is
# not noise.
_MIN_SIGNAL = 0.1


@dataclasses.dataclass(frozen=True)
class Irradiance:
    """Estimates of E on the patches.

    Attributes:
        batches: [B, 7, P, P, 3] independent estimates of equal noise; faces as in `FACES`, patches
            by the two other axes in increasing order.
    """

    batches: NDArray[np.float64]

    @property
    def mean(self) -> NDArray[np.float64]:
        """[7, P, P, 3] estimate by all rays."""
        return self.batches.mean(axis=0)

    @property
    def lux(self) -> NDArray[np.float64]:
        """[7, P, P] illuminance of the patches in lx, for radiance in W/(m² sr)."""
        return luminance(self.mean)


@dataclasses.dataclass(frozen=True)
class IrradianceError:
    """How far one estimate of E is from another, by luminance; noise of both is accounted for.

    Attributes:
        ratio, ratio_error: [7] mean of each face over the reference's, and standard error. NaN for
            a face that no light of the reference reaches.
        rms, rms_error: [7] root mean square difference of the patches of each face over the
            reference's root mean square; the expected contribution of noise is subtracted from the
            mean square, and a difference below the noise counts as 0. The error is what it grows
            by if the mean square is one standard error more, by the jackknife. NaN for a face where
            nine tenths of the reference's mean square are noise.
        total_ratio, total_ratio_error: flux through the six faces of the cube over the
            reference's, and standard error.
    """

    ratio: NDArray[np.float64]
    ratio_error: NDArray[np.float64]
    rms: NDArray[np.float64]
    rms_error: NDArray[np.float64]
    total_ratio: float
    total_ratio_error: float

    @property
    def mean_rms(self) -> float:
        """Mean of `rms` over the faces of the cube where it is not NaN; NaN if there are none."""
        known = self.rms[:NUM_CUBE_FACES][np.isfinite(self.rms[:NUM_CUBE_FACES])]
        return float(known.mean()) if known.size else np.nan


@dataclasses.dataclass(frozen=True)
class IrradianceEvaluation:
    """Irradiance around an asset, compared with that around its luminaire.

    Attributes:
        num_paths: light paths of the luminaire, and rays of the asset.
        explicit, baked: estimates for what is compared with, and for the asset.
        error: of `baked`.
    """

    num_paths: int
    explicit: Irradiance
    baked: Irradiance
    error: IrradianceError

    @property
    def metrics(self) -> dict[str, float]:
        """`irradiance_ratio`, `irradiance_rms` and `irradiance_rms_touching`.

        One that is not defined (see `IrradianceError`) is omitted.
        """
        values = {
            "irradiance_ratio": self.error.total_ratio,
            "irradiance_rms": self.error.mean_rms,
            "irradiance_rms_touching": float(self.error.rms[FACES.index("touching")]),
        }
        return {name: value for name, value in values.items() if math.isfinite(value)}

    def report(self) -> dict[str, Any]:
        """Values for JSON.

        Returns:
            `paths`; `ratio_error`, the standard error of `irradiance_ratio`; and `faces`: for each
            of `FACES` the means `explicit_lux` and `baked_lux`, `ratio`, `ratio_error`, `rms` and
            `rms_error`. Undefined values (see `IrradianceError`) are None.
        """
        columns = {
            "explicit_lux": self.explicit.lux.mean(axis=(1, 2)),
            "baked_lux": self.baked.lux.mean(axis=(1, 2)),
            "ratio": self.error.ratio,
            "ratio_error": self.error.ratio_error,
            "rms": self.error.rms,
            "rms_error": self.error.rms_error,
        }
        faces = {
            face: {name: _finite(values[index]) for name, values in columns.items()}
            for index, face in enumerate(FACES)
        }
        return {
            "paths": self.num_paths,
            "ratio_error": _finite(self.error.total_ratio_error),
            "faces": faces,
        }


def luminaire_irradiance(
    luminaire: Luminaire, num_paths: int, *, path_depth: int = PATH_DEPTH, seed: int = 0
) -> Irradiance:
    """Irradiance that a luminaire causes, by light paths.

    Args:
        num_paths: light paths, rounded up to a multiple of `BATCHES`.
        path_depth: longest path, events.

    Raises:
        LumitreeError: a path's flux is NaN or infinite.
    """
    rays = LampRays(luminaire, path_depth)
    return rays_irradiance(rays, luminaire.frame.half_extents, num_paths, draw=0, seed=seed)


def asset_irradiance(asset: Asset, num_rays: int, *, seed: int = 0) -> Irradiance:
    """Irradiance that a baked luminaire causes, by rays sampled from its emission."""
    return rays_irradiance(AssetRays(asset), asset.frame.half_extents, num_rays, seed=seed)


def rays_irradiance(
    rays: EmittedRays,
    half_extents: NDArray[np.float64],
    num_rays: int,
    *,
    draw: int = 1,
    seed: int = 0,
) -> Irradiance:
    """Irradiance that a representation of a luminaire causes, by its rays.

    Args:
        num_rays: rounded up to a multiple of `BATCHES`.
        draw: of `Purpose.IRRADIANCE`.
    """
    drawn = RayBatches(
        rays, num_rays, lambda batch, _: SeedStream(Purpose.IRRADIANCE, batch, draw), seed
    )
    batches = []
    with progress("irradiance", drawn.count) as advance:
        for _, batch in drawn:
            batches.append(_accumulate(batch, half_extents))
            advance(1)
    return Irradiance(np.array(batches))


def irradiance_error(estimate: Irradiance, reference: Irradiance) -> IrradianceError:
    """Compare two estimates of the irradiance around a luminaire."""
    first, second = luminance(estimate.batches), luminance(reference.batches)
    values, error = jackknife(lambda used: _compare(first[used], second[used]), len(first))
    ratio, square = slice(0, len(FACES)), slice(len(FACES), 2 * len(FACES))
    # Of a square that is below its noise, the root has no derivative.
    least = np.maximum(values[square], 0)
    rms = np.sqrt(least)
    return IrradianceError(
        values[ratio],
        error[ratio],
        rms,
        np.sqrt(least + error[square]) - rms,
        total_ratio=float(values[-1]),
        total_ratio_error=float(error[-1]),
    )


def evaluate_irradiance(
    asset: Asset, reference: Luminaire | Asset, num_paths: int
) -> IrradianceEvaluation:
    """Compare the irradiance around an asset with that around its luminaire.

    Args:
        reference: the luminaire, or another asset. It must have a bounding box of the asset's
            proportions, which `evaluate_views` checks.
        num_paths: light paths of the luminaire, and as many rays of the asset.

    Raises:
        LumitreeError: a path's flux is NaN or infinite.
    """
    if isinstance(reference, Asset):
        # Another seed than for `asset`: the two estimates are independent.
        explicit = asset_irradiance(reference, num_paths, seed=1)
    else:
        explicit = luminaire_irradiance(reference, num_paths)
    baked = asset_irradiance(asset, num_paths)
    return IrradianceEvaluation(num_paths, explicit, baked, irradiance_error(baked, explicit))


def _compare(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compare two [B, 7, P, P].

    Returns:
        [15] 7 ratios of means, 7 relative mean square differences without noise, which may be
        negative, and the ratio of the means over the faces of the cube. See `IrradianceError` for
        what is NaN.
    """
    a, b = first.mean(0), second.mean(0)
    noise_a, noise_b = first.var(0, ddof=1) / len(first), second.var(0, ddof=1) / len(second)
    faces = (1, 2)
    square = ((a - b) ** 2 - noise_a - noise_b).sum(faces)
    norm = (b**2 - noise_b).sum(faces)
    light_a, light_b = a.sum(faces), b.sum(faces)
    cube = slice(NUM_CUBE_FACES)
    return np.concatenate(
        [
            _divide(light_a, light_b, light_b > 0),
            _divide(square, norm, norm > _MIN_SIGNAL * (b**2).sum(faces)),
            _divide(light_a[cube].sum(), light_b[cube].sum(), light_b[cube].any()),
        ],
        axis=None,
    )


def _divide(a: ArrayLike, b: ArrayLike, defined: ArrayLike) -> NDArray[np.float64]:
    """a / b, and NaN where that is not defined."""
    return np.divide(a, b, out=np.full(np.shape(a), np.nan), where=np.asarray(defined))


def _accumulate(rays: RayBatch, half_extents: NDArray[np.float64]) -> NDArray[np.float64]:
    """E [7, P, P, 3] by rays that start inside the bounding box."""
    position, towards, carried = rays.arrays()
    side = 2 * CUBE_HALF_SIDE / PATCHES
    total = np.zeros((len(FACES) * PATCHES**2, 3))
    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (np.copysign(CUBE_HALF_SIDE, towards) - position) / towards
        axis = np.nanargmin(np.where(towards == 0, np.inf, distance), axis=1)
        rows = np.arange(len(axis))
        face = 2 * axis + (towards[rows, axis] > 0)
        _add(total, face, axis, position + distance[rows, axis, None] * towards, carried, side)
        below = (-half_extents[1] - position[:, 1]) / towards[:, 1]
    down = towards[:, 1] < 0
    where = position[down] + np.maximum(below[down], 0)[:, None] * towards[down]
    hits = (np.abs(where[:, [0, 2]]) < CUBE_HALF_SIDE).all(axis=1)
    ones = np.ones(hits.sum(), np.int64)
    _add(total, 6 * ones, ones, where[hits], carried[down][hits], side)
    return total.reshape(len(FACES), PATCHES, PATCHES, 3) / side**2


def _add(total, face, axis, where, flux, side):
    """Add the flux of rays that reach points of faces perpendicular to an axis."""
    patch = np.clip(((where + CUBE_HALF_SIDE) / side).astype(np.int64), 0, PATCHES - 1)
    rows = np.arange(len(axis))
    first, second = np.where(axis == 0, 1, 0), np.where(axis == 2, 1, 2)
    index = (face * PATCHES + patch[rows, first]) * PATCHES + patch[rows, second]
    for channel in range(3):
        total[:, channel] += np.bincount(index, flux[:, channel], len(total))


def _finite(value: float) -> float | None:
    """The value; None if it is NaN or infinite, which JSON does not have."""
    return float(value) if math.isfinite(value) else None
