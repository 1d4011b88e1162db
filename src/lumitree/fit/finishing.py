"""Folder of the state of a bake, and the end of every bake: writes and measures the asset.

An asset that has a radiance field only gets a light field, of the field's own rays.
"""

import contextlib
import dataclasses
from collections.abc import Iterator
from pathlib import Path
from typing import TYPE_CHECKING, Any

from lumitree.asset.asset import Asset
from lumitree.asset.file import as_stored, save
from lumitree.asset.light_field import make_light_field
from lumitree.core.backend import load_mitsuba
from lumitree.core.checkpoint import CHECKPOINTS
from lumitree.core.files import FilePath, WorkFolder, WriteError, scratch_folder
from lumitree.core.interruption import deferred_interrupt, interruptible, interruption_behind
from lumitree.core.progress import progress
from lumitree.core.results import Json, Result, Stopwatch, plain
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.dataset import DATASET_FILES
from lumitree.measure.irradiance import measure_irradiance
from lumitree.rendering.asset_cache import asset_json

if TYPE_CHECKING:
    from lumitree.lamp.luminaire import Luminaire

# Grid and bins of direction a side, as of a bake; batches, and rays of each.
_DEPTH, _RESOLUTION = 5, 32
_BATCHES, _BATCH = 4, 1 << 20


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class BakeResult(Result):
    """Result of a bake.

    Attributes:
        asset: the baked luminaire.
        path: file of the asset; None if none was written.
        irradiance: error of the irradiance around the asset: `irradiance_ratio`, `irradiance_rms`
            and `irradiance_rms_touching`, as in `EvaluateResult.metrics`, and `paths`,
            `ratio_error`, `faces` and `flux`, as in `EvaluateResult.irradiance`. None if it was not
            compared: for a dataset, for 0 `irradiance_paths`, and after an interruption.
        held_out_psnr: PSNR on held-out rays, dB; None if no field was baked from
            rays.
        held_out_psnr_uncertainty: half the width of the 68 % interval of `held_out_psnr`, dB.
        rays: rays of the gradient descent, including the rays of the calls that this one continued;
            None if no field was baked from rays.
        stopped_by: number of the signal that interrupted the bake; None if there was none.
            The asset is then the best so far, or `complete`.
        complete: whether the asset is complete.
        finished: whether the bake is finished: the asset is complete, and the irradiance around it
            was compared if it should be. A signal may have arrived afterwards.
    """

    asset: Asset
    path: Path | None
    irradiance: Json | None = None
    held_out_psnr: float | None = None
    held_out_psnr_uncertainty: float | None = None
    rays: int | None = None
    stopped_by: int | None = None
    complete: bool = dataclasses.field(default=True, repr=False)
    finished: bool = dataclasses.field(default=True, repr=False)

    def to_json(self) -> Json:
        """Dictionary of the result, for `json.dumps`, with `Asset.info` in place of the asset."""
        values = {field.name: getattr(self, field.name) for field in self._shown()}
        del values["path"]
        values["asset"] = asset_json(self.asset, self.path)
        return {name: plain(value) for name, value in values.items() if value is not None}


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


def with_field_light(asset: Asset) -> Asset:
    """The asset with a light field, which illuminates scenes; as it is if it has one.

    It is made of rays that leave the radiance field, with equal random numbers for equal fields.
    Nothing is added if the field emits no light.
    """
    if asset.light_field is not None or not asset.num_leaves:
        return asset
    load_mitsuba()
    from lumitree.core.octahedral import intensity_of_histogram
    from lumitree.rendering.asset_flux import AssetRays
    from lumitree.trace.histograms import Histogram
    from lumitree.trace.light_paths import as_rows

    rays, histogram = AssetRays(asset.without_factors), Histogram(_DEPTH, _RESOLUTION)
    with progress("light", _BATCHES) as advance:
        for batch in range(_BATCHES):
            drawn = rays.draw(_BATCH, SeedStream(Purpose.FIELD_RAYS, batch).seed(0))
            histogram.add(drawn.origin, drawn.direction, as_rows(drawn.flux).T / _BATCHES)
            advance(1)
    if not histogram.flux.any():
        return asset
    intensity = intensity_of_histogram(histogram.flux)
    field = make_light_field(histogram.cells, intensity, _DEPTH)
    return dataclasses.replace(asset, light_field=field)
