"""The end of every bake: the asset is written, and the irradiance around it is measured."""

import dataclasses
from collections.abc import Iterable
from typing import TYPE_CHECKING, Any

from lumitree.asset.asset import Asset
from lumitree.asset.file import as_stored
from lumitree.core.files import FilePath, WorkFolder
from lumitree.core.interruption import deferred_interrupt, interruptible, interruption_behind
from lumitree.core.stopwatch import Stopwatch
from lumitree.fit.field_light import with_field_light
from lumitree.fit.result import BakeResult
from lumitree.fit.work import save_asset
from lumitree.measure.irradiance_check import measure_irradiance

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire


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
    asset = as_stored(with_field_light(asset))
    irradiance, complete = None, stopped_by is None
    with deferred_interrupt() as interruption:
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


def remove_state(
    folder: WorkFolder, work: FilePath | None, result: BakeResult, names: Iterable[str]
) -> None:
    """Remove the saved state of a bake, unless it is not finished or its folder is the user's."""
    if work is None and result.finished:
        folder.remove(names)
