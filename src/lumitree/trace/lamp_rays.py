"""The rays that a luminaire emits: light paths, checked to be finite."""

import numpy as np
from numpy.typing import NDArray

from lumitree.lamp.luminaire import Luminaire
from lumitree.trace.emitted_rays import as_rows, seeded_sampler
from lumitree.trace.ending_segments import EndingConfig
from lumitree.trace.light_paths import LightPaths, emitted_flux, trace_light
from lumitree.trace.tracing import PATH_DEPTH, check_finite


class LampRays:
    """Light paths of a luminaire, all that leave it; `EmittedRays`.

    Args:
        luminaire: what is traced.
        path_depth: longest path, events.
    """

    def __init__(self, luminaire: Luminaire, path_depth: int = PATH_DEPTH) -> None:
        self._luminaire, self._path_depth = luminaire, path_depth

    def draw(
        self,
        count: int,
        seed: int,
        *,
        ending: EndingConfig | None = None,
        largest_gain: float | None = None,
    ) -> LightPaths:
        """As `EmittedRays.draw`.

        Args:
            count: number of light paths.
            seed: of the draw.
            ending: also return segments that end on the luminaire. The paths are the same with it.
            largest_gain: limit of the gain of a path's flux, see `trace_light`.

        Raises:
            LumitreeError: a path's flux is NaN or infinite.
        """
        sampler = seeded_sampler(seed, count)
        paths = trace_light(
            self._luminaire,
            sampler,
            count,
            self._path_depth,
            all_light=True,
            ending=ending,
            largest_gain=largest_gain,
        )
        check_finite(self._luminaire, as_rows(paths.flux))
        if paths.ending is not None:
            check_finite(self._luminaire, as_rows(paths.ending.flux))
        return paths

    def bare_flux(self, count: int, seed: int) -> NDArray[np.float64]:
        """Flux [3] with which the paths of `draw` start, before the luminaire absorbs any.

        It is an estimate of the flux of the bare emitters, local units.
        """
        sampler = seeded_sampler(seed, count)
        return as_rows(emitted_flux(self._luminaire, sampler, count)[0]).sum(axis=0)
