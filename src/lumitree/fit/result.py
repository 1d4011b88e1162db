"""The results of a bake and of the steps of the network."""

import dataclasses
from pathlib import Path

from lumitree.asset.asset import Asset
from lumitree.core.results import Json, Result, plain
from lumitree.rendering.asset_cache import asset_json


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


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class CaptureResult(Result):
    """Result of a capture.

    Attributes:
        dataset: folder of the dataset.
        luminaire: name of the luminaire.
        views: number of views in the dataset.
    """

    dataset: Path
    luminaire: str
    views: int


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class TrainResult(Result):
    """Result of the training of a network.

    Attributes:
        run: folder of the checkpoints.
        steps: number of steps, including steps of earlier calls.
        psnr: PSNR on held-out rays, dB.
        psnr_black: PSNR of an all-black prediction of the same rays, dB.
        rays_per_second: training speed of this call.
        stopped_by: number of the signal that interrupted the training; None if there was none.
        finished: whether the training is finished. A signal may have arrived afterwards.
    """

    run: Path
    steps: int
    psnr: float
    psnr_black: float
    rays_per_second: float
    stopped_by: int | None = None
    finished: bool = dataclasses.field(default=True, repr=False)

    @property
    def continues(self) -> str:
        """Command or call that continues it, for messages."""
        return "the same command with --resume continues"
