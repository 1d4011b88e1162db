"""Irradiance around a luminaire by the light that leaves it, and the check of every bake by it.

A cube three times the size of the luminaire's bounding box stands around it, in its local frame. A
seventh square touches the lower side of the bounding box, as a table below a lamp might. Each
square is divided into patches, which the flux of the emitted rays is summed over. The origins of
the rays have no influence, so every representation of a luminaire from which emitted rays can be
sampled is compared in the same way.

The flux of a luminaire is also compared with the flux by camera paths. Light paths start on
emitters, and all that is baked comes from them; camera paths find emitters only by hitting them. A
material or an emitter that one of the two gets wrong shows as a difference.

Symbols
    E       irradiance of a patch, R, G and B: flux of the rays that reach it over its area, in the
            luminaire's units of radiance times sr
"""

import dataclasses
import math
import warnings
from typing import TYPE_CHECKING

import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField
from lumitree.core.arguments import check_count
from lumitree.core.photometry import Flux, flux_text, luminance
from lumitree.core.progress import progress
from lumitree.core.results import Json, Stopwatch
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeWarning
from lumitree.measure.batches import RayBatches, jackknife

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire
    from lumitree.trace.light_paths import EmittedRays, RayBatch

FACES = ("-x", "+x", "-y", "+y", "-z", "+z", "touching")
# The first faces are the faces of the cube.
NUM_CUBE_FACES = 6
# Half side of the cube, local units, and patches along a side of each square.
CUBE_HALF_SIDE = 3.0
PATCHES = 12
# More paths would need more than some gigabytes of memory.
_MAX_PATHS = 1 << 26
# The RMS difference of a face is defined if at least this part of the reference's mean square is
# not noise.
_MIN_SIGNAL = 0.1
# Light fields have RMS errors of a few percent. Above this there is a cause, and a warning.
_LARGEST_RMS = 0.1
# The warning names few cells, or light in one far part of the box: the distance of the mean cell
# from the middle, local units.
_FEW_CELLS, _FAR = 20, 0.5
# Camera paths of the comparison of flux. Before it warns, both fluxes are estimated again by other
# and more paths: one lamp in some hundreds differs randomly.
_CAMERA_PATHS, _PATHS_AGAIN = 1 << 20, 1 << 22
# The fluxes differ if they do so by more standard errors than this, and by more than this part.
_ERRORS, _PART = 3, 0.02
# Hits of an emitter from which on the standard error of camera paths is known.
_FEWEST = 100


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
            mean square, and a difference below the noise counts as 0. The error is the increase of
            `rms` if the mean square is one standard error (jackknife) more. NaN for a face where
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
    """Irradiance around an asset, compared with the irradiance around its luminaire.

    Attributes:
        num_paths: light paths of the luminaire, and rays of the asset.
        explicit, baked: estimates for the reference, and for the asset.
        error: of `baked`.
    """

    num_paths: int
    explicit: Irradiance
    baked: Irradiance
    error: IrradianceError

    @property
    def metrics(self) -> dict[str, float]:
        """`irradiance_ratio`, `irradiance_rms` and `irradiance_rms_touching`.

        An undefined value (see `IrradianceError`) is omitted.
        """
        values = {
            "irradiance_ratio": self.error.total_ratio,
            "irradiance_rms": self.error.mean_rms,
            "irradiance_rms_touching": float(self.error.rms[FACES.index("touching")]),
        }
        return {name: value for name, value in values.items() if math.isfinite(value)}

    def report(self) -> Json:
        """Values for JSON.

        Returns:
            `paths`; `ratio_error`, the standard error of `irradiance_ratio`; and `faces`: for each
            of `FACES` the means `explicit_lux` and `baked_lux`, `ratio`, `ratio_error`, `rms` and
            `rms_error`. Undefined values (see `IrradianceError`) are None.
        """

        def finite(value: float) -> float | None:
            return float(value) if math.isfinite(value) else None

        columns = {
            "explicit_lux": self.explicit.lux.mean(axis=(1, 2)),
            "baked_lux": self.baked.lux.mean(axis=(1, 2)),
            "ratio": self.error.ratio,
            "ratio_error": self.error.ratio_error,
            "rms": self.error.rms,
            "rms_error": self.error.rms_error,
        }
        faces = {
            face: {name: finite(values[index]) for name, values in columns.items()}
            for index, face in enumerate(FACES)
        }
        ratio_error = finite(self.error.total_ratio_error)
        return {"paths": self.num_paths, "ratio_error": ratio_error, "faces": faces}


def check_irradiance_paths(paths: int) -> None:
    """Refuse a number of paths that is negative, or that needs too much memory."""
    check_count("irradiance_paths", paths, 0, _MAX_PATHS)


def measure_irradiance(
    asset: Asset, luminaire: "Luminaire", num_paths: int, watch: Stopwatch
) -> Json | None:
    """Compare the irradiance around an asset, without its factors, and around its luminaire.

    Warns of a large error, and of fluxes of the luminaire that differ.

    Args:
        num_paths: light paths of the luminaire, and rays of the asset. 0: it is not compared.
        watch: measures the stage "irradiance".

    Returns:
        `irradiance` of a `BakeResult`; None if it was not compared.
    """
    if num_paths == 0:
        return None
    with watch.stage("irradiance"):
        found = evaluate_irradiance(asset.without_factors, luminaire, num_paths)
        if asset.light_field is not None:
            _warn_of_error(found.error, asset.light_field, asset.luminaire)
        return found.metrics | found.report() | {"flux": check_flux(luminaire, found.explicit)}


def evaluate_irradiance(
    asset: Asset, reference: "Luminaire | Asset", num_paths: int
) -> IrradianceEvaluation:
    """Compare the irradiance around an asset with the irradiance around its luminaire.

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


def luminaire_irradiance(luminaire: "Luminaire", num_paths: int, *, seed: int = 0) -> Irradiance:
    """Irradiance that a luminaire causes, by light paths (rounded up to a multiple of `BATCHES`).

    Raises:
        LumitreeError: a path's flux is NaN or infinite.
    """
    from lumitree.trace.light_paths import LampRays

    return rays_irradiance(
        LampRays(luminaire), luminaire.frame.half_extents, num_paths, draw=0, seed=seed
    )


def asset_irradiance(asset: Asset, num_rays: int, *, seed: int = 0) -> Irradiance:
    """Irradiance that a baked luminaire causes, by rays sampled from its emission."""
    from lumitree.rendering.asset_flux import AssetRays

    return rays_irradiance(AssetRays(asset), asset.frame.half_extents, num_rays, seed=seed)


def rays_irradiance(
    rays: "EmittedRays",
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


def _accumulate(rays: "RayBatch", half_extents: NDArray[np.float64]) -> NDArray[np.float64]:
    """E [7, P, P, 3] by rays that start inside the bounding box."""
    position, towards, carried = rays.arrays()
    side = 2 * CUBE_HALF_SIDE / PATCHES
    total = np.zeros((len(FACES) * PATCHES**2, 3))

    def add(
        face: NDArray[np.int64],
        axis: NDArray[np.int64],
        where: NDArray[np.float64],
        flux: NDArray[np.float64],
    ) -> None:
        """Add the flux of rays that reach points of faces perpendicular to an axis."""
        patch = np.clip(((where + CUBE_HALF_SIDE) / side).astype(np.int64), 0, PATCHES - 1)
        rows = np.arange(len(axis))
        first, second = np.where(axis == 0, 1, 0), np.where(axis == 2, 1, 2)
        index = (face * PATCHES + patch[rows, first]) * PATCHES + patch[rows, second]
        for channel in range(3):
            total[:, channel] += np.bincount(index, flux[:, channel], len(total))

    with np.errstate(divide="ignore", invalid="ignore"):
        distance = (np.copysign(CUBE_HALF_SIDE, towards) - position) / towards
        axis = np.nanargmin(np.where(towards == 0, np.inf, distance), axis=1)
        rows = np.arange(len(axis))
        face = 2 * axis + (towards[rows, axis] > 0)
        add(face, axis, position + distance[rows, axis, None] * towards, carried)
        below = (-half_extents[1] - position[:, 1]) / towards[:, 1]
    down = towards[:, 1] < 0
    where = position[down] + np.maximum(below[down], 0)[:, None] * towards[down]
    hits = (np.abs(where[:, [0, 2]]) < CUBE_HALF_SIDE).all(axis=1)
    ones = np.ones(hits.sum(), np.int64)
    add(NUM_CUBE_FACES * ones, ones, where[hits], carried[down][hits])
    return total.reshape(len(FACES), PATCHES, PATCHES, 3) / side**2


def irradiance_error(estimate: Irradiance, reference: Irradiance) -> IrradianceError:
    """Compare two estimates of the irradiance around a luminaire."""
    first, second = luminance(estimate.batches), luminance(reference.batches)
    values, error = jackknife(lambda used: _compare(first[used], second[used]), len(first))
    ratio, square = slice(0, len(FACES)), slice(len(FACES), 2 * len(FACES))
    # The root has no derivative at a mean square below the noise, which counts as 0.
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


def _compare(first: NDArray[np.float64], second: NDArray[np.float64]) -> NDArray[np.float64]:
    """Compare two [B, 7, P, P].

    Returns:
        [15] 7 ratios of means, 7 relative mean square differences without noise, which may be
        negative, and the ratio of the means over the faces of the cube; NaN as `IrradianceError`.
    """

    def divide(a: ArrayLike, b: ArrayLike, defined: ArrayLike) -> NDArray[np.float64]:
        return np.divide(a, b, out=np.full(np.shape(a), np.nan), where=np.asarray(defined))

    a, b = first.mean(0), second.mean(0)
    noise_a, noise_b = first.var(0, ddof=1) / len(first), second.var(0, ddof=1) / len(second)
    faces = (1, 2)
    square = ((a - b) ** 2 - noise_a - noise_b).sum(faces)
    norm = (b**2 - noise_b).sum(faces)
    light_a, light_b = a.sum(faces), b.sum(faces)
    cube = slice(NUM_CUBE_FACES)
    return np.concatenate(
        [
            divide(light_a, light_b, light_b > 0),
            divide(square, norm, norm > _MIN_SIGNAL * (b**2).sum(faces)),
            divide(light_a[cube].sum(), light_b[cube].sum(), light_b[cube].any()),
        ],
        axis=None,
    )


def _warn_of_error(error: IrradianceError, field: LightField, name: str) -> None:
    """Warn of an RMS error above `_LARGEST_RMS` that is not noise, with its likely cause."""
    if not error.mean_rms - np.nanmean(error.rms_error) > _LARGEST_RMS:
        return
    middle = (field.cells.mean(axis=0) + 0.5) / (1 << field.depth) * 2 - 1
    if np.abs(middle).max() > _FAR:
        cause = "its light starts in one far part of its box; remove what makes the box large"
    elif len(field.cells) < _FEW_CELLS:
        cause = (
            f"its light starts in only {len(field.cells)} cells; bake it with a larger "
            "LightFieldConfig.depth"
        )
    else:
        cause = (
            "look for a material that makes narrow beams, such as smooth metal or glass in place "
            "of rough"
        )
    warnings.warn(
        f"the irradiance around {name} has an RMS error of {error.mean_rms:.0%}, expected at most "
        f"{_LARGEST_RMS:.0%}: {cause}",
        LumitreeWarning,
        stacklevel=3,
    )


def check_flux(luminaire: "Luminaire", explicit: Irradiance) -> Json:
    """Compare the flux by light paths with the flux by camera paths; warn where they differ.

    Args:
        explicit: irradiance of the luminaire by light paths, on a cube that all of them reach.

    Returns:
        `light_paths` and `camera_paths`, lm for lengths in metres, with the standard errors
        `light_paths_error` and `camera_paths_error`. The last two are None where too few
        camera paths hit an emitter.
    """
    from lumitree.trace.flux import estimate_flux, flux_by_camera_paths

    patch = (2 * CUBE_HALF_SIDE / PATCHES * luminaire.frame.scale) ** 2
    lumens = patch * luminance(explicit.batches[:, :NUM_CUBE_FACES]).sum(axis=(1, 2, 3))
    light, light_error = float(lumens.mean()), float(lumens.std(ddof=1) / math.sqrt(len(lumens)))
    camera = flux_by_camera_paths(luminaire, _CAMERA_PATHS)
    known = camera.hits >= _FEWEST
    if known and _differ(light, light_error, camera):
        again = estimate_flux(luminaire, _PATHS_AGAIN, seed=1)
        light, light_error = again.lumens, again.lumens_error
        camera = flux_by_camera_paths(luminaire, _PATHS_AGAIN, seed=1)
    if known and _differ(light, light_error, camera):
        warnings.warn(
            f"{luminaire.name} emits {flux_text(light, light_error)} by light paths, but {camera} "
            "by camera paths that hit its emitters; one of both is wrong: look for surfaces that "
            "coincide, for materials that create light, and for glass that is not closed",
            LumitreeWarning,
            stacklevel=3,
        )
    return {
        "light_paths": light,
        "light_paths_error": light_error,
        "camera_paths": camera.lumens if known else None,
        "camera_paths_error": camera.lumens_error if known else None,
    }


def _differ(light: float, light_error: float, camera: Flux) -> bool:
    difference = abs(light - camera.lumens)
    error = np.hypot(light_error, camera.lumens_error)
    return difference > _ERRORS * error and difference > _PART * max(light, camera.lumens)
