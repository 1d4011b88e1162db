"""Folder of the state of a bake, and the end of every bake: writes and measures the asset."""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lumitree.asset.asset import Asset
from lumitree.asset.file import as_stored, save
from lumitree.core.checkpoint import CHECKPOINTS
from lumitree.core.files import FilePath, WorkFolder, WriteError, scratch_folder
from lumitree.core.interruption import deferred_interrupt, interruptible, interruption_behind
from lumitree.core.results import Stopwatch
from lumitree.errors import LumitreeError, shown
from lumitree.fit.field_light import with_field_light
from lumitree.fit.result import BakeResult
from lumitree.lamp.dataset import DATASET_FILES
from lumitree.measure.irradiance import measure_irradiance

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire


def save_asset(asset: Asset, output: FilePath | None) -> Path | None:
    """Write an asset to `output`; returns its path. Does nothing and returns None for None."""
    if output is None:
        return None
    save(asset, output)
    return Path(output)


def work_folder_of(output: FilePath | None) -> Path:
    """The folder in which the bake of an asset keeps its state, if none was chosen."""
    return Path(str(output)).with_suffix(".work")


@contextlib.contextmanager
def open_work_folder(output: FilePath | None, work: FilePath | None) -> Iterator[WorkFolder]:
    """Context with the folder in which a bake keeps its state: `work` if it is given.

    Else it has the name of `output` with the suffix `.work`, or is a temporary one without output.

    Raises:
        LumitreeError: the folder cannot be used; and for a `WriteError` that the block raises if
            the folder then holds state, which it says.
    """
    temporary = work is None and output is None
    with contextlib.ExitStack() as stack:
        if temporary:
            work = stack.enter_context(scratch_folder()) / "work"
        elif work is None:
            work = work_folder_of(output)
        folder = stack.enter_context(WorkFolder(str(work)))
        try:
            yield folder
        except WriteError as error:
            if temporary or folder.is_empty:
                raise
            raise LumitreeError(
                f"{error}; the same command continues from what {shown(folder.path, 300)} holds"
            ) from error


def finish_bake(
    asset: Asset,
    output: FilePath | None,
    watch: Stopwatch,
    luminaire: "Luminaire | None" = None,
    irradiance_paths: int = 0,
    stopped_by: int | None = None,
    **figures: Any,
) -> BakeResult:
    """Write an asset with the spectrum of its luminaire, and compare the irradiance around both.

    An asset with a radiance field only gets a light field (`with_field_light`).

    Args:
        watch: measures the stage "irradiance"; all its times become the result's.
        luminaire: what was baked; None: the asset keeps its spectrum, and the irradiance is not
            compared.
        irradiance_paths: as for `measure_irradiance`.
        stopped_by: number of the signal that interrupted the bake, or of one that arrives here: the
            asset is written then, but the irradiance is not compared.
        figures: other fields of the result.
    """
    if luminaire is not None:
        from lumitree.trace.flux import emitted_spectrum

        asset = dataclasses.replace(asset, spectrum=emitted_spectrum(luminaire))
    irradiance, complete = None, stopped_by is None
    with deferred_interrupt() as interruption:
        asset = as_stored(with_field_light(asset))
        path = save_asset(asset, output)
    stopped_by = interruption.number if stopped_by is None else stopped_by
    compares = luminaire is not None and irradiance_paths > 0
    if luminaire is not None and stopped_by is None:
        try:
            with interruptible():
                irradiance = measure_irradiance(asset, luminaire, irradiance_paths, watch)
        except (Exception, KeyboardInterrupt) as error:
            if (interrupted := interruption_behind(error)) is None:
                raise
            stopped_by = interrupted.number
    return BakeResult(
        asset=asset,
        path=path,
        irradiance=irradiance,
        stopped_by=stopped_by,
        complete=complete,
        finished=complete and (irradiance is not None or not compares),
        **figures,
        **watch.costs(),
    )


def remove_state(folder: WorkFolder, work: FilePath | None, result: BakeResult) -> None:
    """Remove the saved state of a bake, unless it is not finished or its folder is the user's."""
    if work is None and result.finished:
        folder.remove([*CHECKPOINTS, *(f"dataset/{name}" for name in DATASET_FILES)])
