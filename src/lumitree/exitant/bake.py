"""A histogram of light paths by the cell of their last vertex and by direction (decision 62)."""

from pathlib import Path
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.exitant import ExitantField, TracedPaths, make_exitant_field
from lumitree.core.octahedral import bin_of, solid_angles
from lumitree.core.progress import progress
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError
from lumitree.exitant.config import ExitantConfig
from lumitree.exitant.merge import relative_noise
from lumitree.exitant.saved_field import SavedExitantField
from lumitree.luminaire.luminaire import Luminaire
from lumitree.model.photometry import luminance
from lumitree.transport.light_paths import trace_light
from lumitree.transport.tracing import PATH_DEPTH, check_finite


def bake_exitant(luminaire: Luminaire, config: ExitantConfig, folder: Path) -> ExitantField:
    """Estimate the exitant light field of a luminaire, and its noise from the batches' spread.

    Args:
        luminaire: what is baked.
        config: how. Equal settings give equal fields.
        folder: where the field is kept; it is returned if an equal call left it there.

    Raises:
        LumitreeError: no light leaves the luminaire, or a path's flux is NaN or infinite.
    """
    saved = SavedExitantField(folder, luminaire, config)
    if (field := saved.load()) is not None:
        return field
    histogram = Histogram(config.depth, config.resolution)
    batches = -(-config.paths // config.batch)
    by_direction = []
    with progress(f"light of {luminaire.name}", batches) as advance:
        for step in range(batches):
            sampler = mi.load_dict({"type": "independent"})
            sampler.seed(SeedStream(Purpose.EXITANT, step).seed(config.seed), config.batch)
            paths = trace_light(luminaire, sampler, config.batch, PATH_DEPTH, all_light=True)
            flux = np.array(paths.flux, np.float64).reshape(3, -1)
            check_finite(luminaire, flux)
            # Paths have the direction of the camera ray that meets them.
            bins = histogram.add(paths.origin, -paths.direction, flux / batches)
            by_direction.append(np.bincount(bins, luminance(flux.T), config.resolution**2))
            advance(1)
    if not histogram.flux.any():
        raise LumitreeError(
            f"no light leaves {luminaire.name}; look for emitters that are enclosed or black"
        )
    solid_angle = solid_angles(config.resolution)
    traced = TracedPaths(
        count=batches * config.batch,
        seeds=(config.seed,),
        luminaire=luminaire.fingerprint,
        noise=relative_noise(np.array(by_direction) / solid_angle, np.ones(batches)),
    )
    intensity = histogram.flux / solid_angle[:, None]
    field = make_exitant_field(histogram.cells, intensity, config.depth, traced)
    saved.save(field)
    return field


class Histogram:
    """Flux by cell and bin of direction.

    Attributes:
        cells: [C, 3] cells that have light.
        flux: [C, R², 3] flux of the bins of each.
    """

    def __init__(self, depth: int, resolution: int) -> None:
        self._side, self._resolution = 1 << depth, resolution
        # Row of each cell of the grid in `flux`, or -1.
        self._rows = np.full(self._side**3, -1)
        self._codes = np.zeros(0, np.int64)
        self.flux = np.zeros((0, resolution**2, 3))

    @property
    def cells(self) -> NDArray[np.int64]:
        side = self._side
        codes = self._codes
        return np.stack([codes % side, codes // side % side, codes // side**2], axis=1)

    def add(self, origin: Any, direction: Any, flux: NDArray[np.float64]) -> NDArray[np.int64]:
        """Add rays (mi.Point3f, mi.Vector3f, [3, N]) that start inside the grid.

        Returns:
            [N] bins of their directions.
        """
        side = self._side
        cell = mi.Point3i(dr.clip(mi.Point3i(dr.floor((origin + 1) * (side / 2))), 0, side - 1))
        code = np.array((cell.z * side + cell.y) * side + cell.x).astype(np.int64)
        bins = np.array(bin_of(direction, self._resolution)).astype(np.int64)
        new = np.setdiff1d(code, self._codes)
        self._rows[new] = len(self._codes) + np.arange(len(new))
        self._codes = np.append(self._codes, new)
        self.flux = np.concatenate([self.flux, np.zeros((len(new), *self.flux.shape[1:]))])
        index = self._rows[code] * self._resolution**2 + bins
        flat = self.flux.reshape(-1, 3)
        for channel in range(3):
            flat[:, channel] += np.bincount(index, flux[channel], len(flat))
        return bins
