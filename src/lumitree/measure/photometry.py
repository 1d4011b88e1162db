"""Photometry of luminaires and assets."""

import dataclasses
import functools
import os
import warnings
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING, Any, Literal, cast

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_choice, check_count, metres_of
from lumitree.core.backend import in_turn, load_rgb
from lumitree.core.files import FilePath, check_writable
from lumitree.core.progress import ProgressCallback, reporting, show_progress
from lumitree.core.results import Result, Stopwatch
from lumitree.core.seeds import check_seed
from lumitree.errors import LumitreeError, LumitreeWarning, shown
from lumitree.formats.type_c import EDGE, MIN_STEP, Grid, IntensityDistribution
from lumitree.lamp.source import (
    RAY_SUFFIXES,
    WRITTEN_SUFFIXES,
    LuminaireSource,
    refuse_options,
    source_kind,
)
from lumitree.measure.near_field import NearFieldLimit
from lumitree.measure.photometric_figures import PhotometricData, PhotometricFigures, evaluated
from lumitree.rendering.asset_cache import asset_of, refuse_frame

if TYPE_CHECKING:
    from lumitree.formats.tm25 import Rays
    from lumitree.lamp.luminaire import LuminaireLike
    from lumitree.measure.far_field import Source

# Light paths of a measurement: 15 to 30 s on 2 CPU cores. And rays of an asset whose intensities
# need none, for its far field and its opening.
PATHS, EXACT_PATHS = 1 << 22, 1 << 20
# With fewer the standard errors are not reliable.
MIN_PATHS = 1 << 14
# More would take days. A ray file has 36 bytes a ray.
MAX_PATHS, MAX_FILE_RAYS = 1 << 32, 1 << 24
# Samples whose rays a ray file gets.
FILE_RAYS = 1 << 18
OUTPUTS = (*WRITTEN_SUFFIXES, ".html", ".pdf")


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class PhotometryResult(Result, PhotometricFigures):
    """Result of a photometric measurement: the figures of `PhotometricFigures`, and more.

    `png`, which is made when it is asked for, shows a polar plot, a cone diagram and an isocandela
    plot.

    Attributes:
        luminaire: name of the luminaire.
        details: what a photometric file states of how it was made, such as its file generation
            type; empty for other sources.
        near_field: for some directions, the distance from which the far field is within 5 %; empty
            without rays.
        step: of the angles, degrees.
        size: [3] sides of the bounding box, m.
        rays: number of light paths, or of rays of an asset; 0 for a photometric file.
        c_angles, gamma_angles: [C] and [G] angles of the intensities, degrees.
        intensity, intensity_error: [C, G] luminous intensities and standard errors, cd.
        files: files that were written.
        data: all that a report shows.
        ugr: [19, 10] Unified Glare Ratings, see `measure.photometric_figures.ugr_table`; NaN where
            there is none. None if the optional dependency `ugr` is not installed.
    """

    luminaire: str
    details: dict[str, str]
    near_field: list[NearFieldLimit]
    step: float
    size: tuple[float, ...]
    rays: int
    c_angles: NDArray[np.float64] = dataclasses.field(repr=False)
    gamma_angles: NDArray[np.float64] = dataclasses.field(repr=False)
    intensity: NDArray[np.float64] = dataclasses.field(repr=False)
    intensity_error: NDArray[np.float64] = dataclasses.field(repr=False)
    files: list[Path]
    data: PhotometricData = dataclasses.field(repr=False)
    ugr: NDArray[np.float64] | None = dataclasses.field(default=None, repr=False)

    @functools.cached_property
    def png(self) -> bytes:
        """The plots, a PNG file."""
        from lumitree.measure.figures import plots_png

        return plots_png(self.data)

    def _repr_png_(self) -> bytes:
        return self.png


@in_turn
def photometry(
    source: "Asset | LuminaireLike",
    output: FilePath | Sequence[FilePath] = (),
    *,
    step: float | None = None,
    unit: float | str = "m",
    up: Literal["y", "z"] = "y",
    paths: int | None = None,
    file_rays: int = FILE_RAYS,
    seed: int = 0,
    variant: str | None = None,
    progress: ProgressCallback | None = show_progress,
) -> PhotometryResult:
    """Measure the far field of a luminaire or an asset, and write photometric files.

    The luminous intensity by direction, Type C, is estimated from light paths of a luminaire, or
    from rays of an asset. All figures have standard errors. Intensities and flux of an asset with a
    light field are sums over its cells, without noise; a photometric file states its own.

    Args:
        source: an asset, the path of a `.lumitree` file, of a photometric file or of a ray file; or
            a luminaire in any form that `bake` takes except the folder of a dataset.
        output: path of a file to write, or several. The suffix decides: `.ies` (IES LM-63-2019),
            `.ldt` (EULUMDAT), `.ray` or `.tm25ray` (IES TM-25 ray file), `.html` or `.pdf`
            (report). Default: none.
        step: angular step of the intensities in C and gamma, degrees: 0.5 to 30, a divisor of 90.
            Default: the finest of 1, 2.5, 5 and 10 at which the noise of the intensities is at
            most 2 % RMS. For a traced light field the coarsest of 10, 5, 2.5, 1 and 0.5 that is at
            most half of its bins of direction, 2.5 for an asset of `bake`; for a photometric file
            the coarsest that has all of its angles, and for an asset made from one 1, or 0.5 where
            1 does not resolve the intensities.
        unit: unit of length of the source: "m", "cm", "mm", "in", "ft", or the metres in a unit,
            1e-6 to 1e6. Models (`.obj`, `.gltf`, `.glb`) are in metres once they are loaded.
            Photometric files state their unit, and none may be given.
        up: upward axis of the source, "y" or "z". Models and photometric files have y up once they
            are loaded.
        paths: number of light paths, or of rays of an asset, 16,384 to 2³²; rounded up to a
            multiple of 16. Default: 4,194,304; 1,048,576 for an asset with a light field, whose
            far field and opening alone need rays; none for a photometric file, which gets a far
            field only if `paths` are given.
        file_rays: number of light paths whose rays a ray file gets, up to 16,777,216. Paths that
            end inside the luminaire are not in the file.
        seed: root seed of all random numbers, 0 to 2³¹ - 1.
        variant: Mitsuba variant; see `bake`.
        progress: function that is called with a `Progress` after each step; see `bake`.

    Returns:
        The figures, the intensities (`intensity`), and plots as `png`.

    Raises:
        LumitreeError: an argument is out of range; the source cannot be read or emits no light; or
            a file cannot be written.

    Example:
        >>> result = lumitree.photometry("bulbs", ["bulbs.ies", "bulbs.pdf"])
        >>> print(result.lumens, "lm")
    """
    outputs = [output] if isinstance(output, str | os.PathLike) else list(output)
    _check_outputs(outputs)
    if paths is not None:
        check_count("light paths", paths, MIN_PATHS, MAX_PATHS)
    check_count("rays of a ray file", file_rays, 1, MAX_FILE_RAYS)
    check_seed(seed)
    check_choice("up", up, ("y", "z"))
    metres = metres_of(unit)
    load_rgb(variant)
    from lumitree.formats.ies import SIMULATED, UNDEFINED
    from lumitree.formats.photometric_file import read_photometry
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.measure.far_field import (
        asset_source,
        file_source,
        luminaire_source,
        measure,
        oriented,
    )

    if step is not None:
        Grid(step)
    is_file = source_kind(source) == "photometric"
    wanted = file_rays if any(_suffix(path) in RAY_SUFFIXES for path in outputs) else 0
    watch = Stopwatch()
    with reporting(progress), watch.stage("measure"):
        asset = file = None
        # The intensities of a file are known: its asset, which is made of them, adds nothing.
        if is_file and (found := read_photometry(_path(source))) is not None:
            file, measured = found[0], file_source(*found)
        elif (asset := asset_of(source)) is not None:
            measured = asset_source(asset)
        else:
            measured = luminaire_source(load_luminaire(source))
        of_file = file is not None or (asset is not None and asset.is_photometric)
        if of_file:
            refuse_frame(source, metres, up)
        if wanted:
            _warn_far(measured)
        measured = oriented(measured, metres, up)
        if paths is None and measured.exact is not None:
            paths = EXACT_PATHS if file is None or wanted else 0
        paths = PATHS if paths is None else paths
        measurement = measure(measured, paths, step=step, kept_rays=wanted, seed=seed)
        # A converted file is no simulation, and no measurement either.
        generation = UNDEFINED if is_file else SIMULATED
        data = evaluated(measurement, file, generation, of_file=of_file)
        if file is not None and step is None:
            _warn_fine(file, data.step)
    with watch.stage("write"):
        for path in outputs:
            _write(path, data, measurement.rays)
    return PhotometryResult(
        luminaire=measurement.name,
        details=dict(data.distribution.details),
        **{
            each.name: getattr(data.figures, each.name) for each in dataclasses.fields(data.figures)
        },
        near_field=data.near_field,
        ugr=data.ugr,
        step=data.step,
        size=tuple(data.size.tolist()),
        rays=data.num_rays,
        c_angles=data.distribution.c,
        gamma_angles=data.distribution.gamma,
        intensity=data.distribution.intensity,
        intensity_error=data.intensity_error,
        files=[Path(path) for path in outputs],
        data=data,
        **watch.costs(),
    )


def _path(source: object) -> str:
    """Path of a photometric file."""
    if isinstance(source, LuminaireSource):
        refuse_options(source, "an asset or a photometric file")
        return source.name
    return os.fspath(cast(Any, source))


def _check_outputs(outputs: Sequence[FilePath]) -> None:
    for path in outputs:
        if _suffix(path) not in OUTPUTS:
            name = shown(repr(os.fspath(path)), 300)
            raise LumitreeError(f"output {name} does not end in one of {', '.join(OUTPUTS)}")
        check_writable(path)


def _warn_far(source: "Source") -> None:
    """Warn of a ray file whose coordinates would be too coarse."""
    if source.frame.is_far:
        place = ", ".join(f"{each:.10g}" for each in source.frame.centre)
        warnings.warn(
            f"{source.name} is at ({place}) in its file, where the float32 coordinates of a "
            "ray file are too coarse; the rays are written with the lamp at the origin",
            LumitreeWarning,
            stacklevel=4,
        )


def _warn_fine(file: IntensityDistribution, step: float) -> None:
    """Warn of a photometric file whose angles are finer than any grid."""
    steps = np.concatenate([np.diff(file.c), np.diff(file.gamma)])
    # Beside a step at which the light ends.
    least = float(steps.min(initial=MIN_STEP, where=steps > 2 * EDGE))
    if least < MIN_STEP * (1 - 1e-6):
        warnings.warn(
            f"{file.name}: its angles are as little as {least:.3g} degrees apart; beam and field "
            f"angles and the files that are written are of steps of {step:g} degrees",
            LumitreeWarning,
            stacklevel=4,
        )


def _suffix(path: FilePath) -> str:
    return Path(path).suffix.lower()


def _write(path: FilePath, data: PhotometricData, rays: "Rays") -> None:
    from lumitree.formats.ies import write_ies
    from lumitree.formats.ldt import write_ldt
    from lumitree.formats.tm25 import write_tm25

    distribution = data.distribution
    match _suffix(path):
        case ".ies":
            write_ies(path, distribution)
        case ".ldt":
            write_ldt(path, distribution)
        case ".html" | ".pdf" as suffix:
            from lumitree.measure.figures import write_html, write_pdf

            (write_html if suffix == ".html" else write_pdf)(path, data)
        case _:
            write_tm25(path, rays, distribution.name)
