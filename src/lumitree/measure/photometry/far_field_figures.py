"""Computation of photometric figures and their errors from the batches of a measurement."""

import math
from collections.abc import Callable

import numpy as np
from numpy.typing import NDArray

from lumitree.core.photometry import colour_temperature, luminance
from lumitree.formats.ies_fields import SIMULATED
from lumitree.formats.type_c import IntensityDistribution
from lumitree.measure.batches import jackknife
from lumitree.measure.photometry.colour import colour_figures
from lumitree.measure.photometry.far_field import Measurement
from lumitree.measure.photometry.figures import (
    BEAM,
    FIELD,
    PLANES,
    Estimate,
    PhotometricData,
    PhotometricFigures,
    plane_curve,
    width_at,
)
from lumitree.measure.photometry.ugr import ugr_table

Mask = NDArray[np.bool_]
# Standard errors by which the largest intensity must exceed other nodes'.
_CERTAIN = 2


def evaluated(
    measurement: Measurement,
    file: IntensityDistribution | None = None,
    generation: str = SIMULATED,
    *,
    of_file: bool = False,
) -> PhotometricData:
    """Figures, intensities and near-field limits of a measurement.

    Args:
        measurement: of a luminaire or an asset.
        file: the photometric file that the asset was made of: the flux of its lamps and what it
            states of how it was made.
        generation: file generation type of what is written.
        of_file: whether the light is that of a photometric file, also of one that was baked: those
            that state no colour have equal R, G and B.
    """
    grid, emitted = measurement.grid, measurement.emitted

    def lumens(used: Mask) -> float:
        return float(luminance(measurement.watts[used].mean(axis=0)))

    def colour(used: Mask) -> NDArray[np.float64]:
        return np.array(colour_temperature(measurement.watts[used].mean(axis=0)))

    emitted_lumens = ratio = None
    if emitted is not None:

        def bare(used: Mask) -> float:
            return float(luminance(emitted[used].mean(axis=0)))

        emitted_lumens = _estimate(bare)
        # A part of the batches may have found no light.
        ratio = _estimate(lambda used: lumens(used) / (bare(used) or math.inf))
    elif file is not None and (lamps := file.emitted_lumens) is not None:
        emitted_lumens = Estimate(lamps, 0.0)
        ratio = _estimate(lambda used: lumens(used) / lamps)
    intensity, error = jackknife(lambda used: measurement.intensity[used].mean(axis=0))
    # Where it is large with certainty: rare paths of large flux make single nodes uncertain.
    certain = intensity - _CERTAIN * error
    plane, row = np.unravel_index(certain.argmax(), certain.shape)
    (kelvin, duv), (kelvin_error, duv_error) = (each.tolist() for each in jackknife(colour))
    mean = measurement.watts.mean(axis=0)
    coloured = not (of_file and np.allclose(mean, mean[0], rtol=1e-6, atol=0))
    angles = {
        part: {
            name: _estimate(lambda used, c=c, part=part: _width(measurement, used, c, part))
            for name, c in PLANES.items()
        }
        for part in (BEAM, FIELD)
    }
    figures = PhotometricFigures(
        lumens=_estimate(lumens),
        emitted_lumens=emitted_lumens,
        light_output_ratio=ratio,
        upward_share=_estimate(lambda used: measurement.upward[used].mean() / lumens(used)),
        max_candela=Estimate(float(intensity[plane, row]), float(error[plane, row])),
        max_c=float(grid.c[plane]),
        max_gamma=float(grid.gamma[row]),
        beam_angles=angles[BEAM],
        field_angles=angles[FIELD],
        colour_temperature=Estimate(kelvin, kelvin_error)
        if coloured and math.isfinite(kelvin_error)
        else None,
        duv=Estimate(duv, duv_error) if coloured and math.isfinite(duv_error) else None,
        spectrum_share=0.0 if measurement.spectrum is None else measurement.spectrum.share,
        emitted_colour=colour_figures(measurement.spectrum, measurement.watts.mean(axis=0)),
        opening=measurement.opening,
        opening_centre=tuple(measurement.centre.tolist()),
    )
    distribution = IntensityDistribution(
        name=measurement.name,
        c=grid.c,
        gamma=grid.gamma,
        intensity=intensity,
        opening=measurement.opening,
        emitted_lumens=None if emitted_lumens is None else emitted_lumens.value,
        generation=generation,
        details={} if file is None else file.details,
    )
    return PhotometricData(
        figures=figures,
        distribution=distribution,
        intensity_error=error,
        near_field=measurement.near_field.limits(),
        step=grid.step,
        size=measurement.size,
        num_rays=measurement.num_rays,
        ugr=ugr_table(distribution),
    )


def _estimate(figure: Callable[[Mask], float]) -> Estimate:
    value, error = jackknife(figure)
    return Estimate(float(value), float(error))


def _width(measurement: Measurement, used: Mask, c: float, part: float) -> float:
    intensity = measurement.intensity[used].mean(axis=0)
    return width_at(plane_curve(measurement.grid, intensity, c), measurement.grid.step, part)
