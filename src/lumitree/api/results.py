"""What the functions of `lumitree` return: frozen, printable, ready for JSON and for notebooks."""

import dataclasses
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.errors import shown

Json = dict[str, Any]


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class Result:
    """What every result has.

    Attributes:
        seconds: wall time by stage.
        peak_memory_bytes: largest resident memory of the process so far.
    """

    seconds: dict[str, float]
    peak_memory_bytes: int

    def to_json(self) -> Json:
        """The result as values that `json.dumps` takes."""
        return {field.name: plain(getattr(self, field.name)) for field in self._shown()}

    def __repr__(self) -> str:
        lines = [f"{name}: {shown(value, 200)}" for name, value in self.to_json().items()]
        return "\n  ".join([type(self).__name__, *lines])

    def _shown(self) -> list[dataclasses.Field[Any]]:
        return [field for field in dataclasses.fields(self) if field.repr]


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class BakeResult(Result):
    """An asset, and how it was made.

    Attributes:
        asset: what was baked.
        path: its file; None where none was asked for.
        held_out_psnr, held_out_psnr_uncertainty: of rays that the bake did not learn from, dB;
            None for assets that come from a network.
        rays: traced for the descent; None for assets that come from a network.
        stopped_by: number of the signal that ended the bake early, whose best so far this is;
            None if none did.
    """

    asset: Asset
    path: Path | None
    held_out_psnr: float | None = None
    held_out_psnr_uncertainty: float | None = None
    rays: int | None = None
    stopped_by: int | None = None

    def to_json(self) -> Json:
        """The result as values that `json.dumps` takes; figures stand for the asset."""
        values = {field.name: getattr(self, field.name) for field in self._shown()}
        del values["path"]
        values["asset"] = asset_json(self.asset, self.path)
        return {name: plain(value) for name, value in values.items() if value is not None}


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class CaptureResult(Result):
    """A dataset.

    Attributes:
        dataset: its folder.
        luminaire: what it shows.
        views: number of its views.
    """

    dataset: Path
    luminaire: str
    views: int


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class TrainResult(Result):
    """A trained network.

    Attributes:
        run: folder of its checkpoints.
        steps: done in all, those of earlier calls included.
        psnr, psnr_black: of held-out rays, and what black scores on them, dB.
        rays_per_second: of this call.
        stopped_by: number of the signal that ended the training early; None if none did.
    """

    run: Path
    steps: int
    psnr: float
    psnr_black: float
    rays_per_second: float
    stopped_by: int | None = None


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class PictureResult(Result):
    """A result with an image; notebooks show it.

    Attributes:
        png: the image, as the bytes of a PNG file.
    """

    png: bytes = dataclasses.field(repr=False)

    def _repr_png_(self) -> bytes:
        return self.png


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class EvaluateResult(PictureResult):
    """An asset compared with views of its luminaire.

    Attributes:
        metrics: means over the views, by name.
        max_radiance: of the views, W/(m² sr); the metrics' unit.
        views: the metrics of each view.
        asset: figures of the asset.
        sheet: file of the contact sheet; None where none was asked for.
    """

    metrics: dict[str, float]
    max_radiance: float
    views: list[dict[str, Any]]
    asset: Json
    sheet: Path | None


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class RenderResult(PictureResult):
    """A rendered scene.

    Attributes:
        pixels: [H, W, 3] linear radiance.
        image: its file; None where none was asked for.
        resolution: width and height.
        samples_per_pixel: that it is the mean of.
        mean_radiance: over pixels and channels, W/(m² sr).
    """

    pixels: NDArray[np.float32] = dataclasses.field(repr=False)
    image: Path | None
    resolution: tuple[int, int]
    samples_per_pixel: int
    mean_radiance: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flux:
    """Light that leaves a luminaire, for lengths in metres, with one standard error.

    Attributes:
        watts, watts_error: R, G and B, W.
        lumens, lumens_error: lm.
        paths: that the estimate is the mean of.
    """

    watts: tuple[float, ...]
    watts_error: tuple[float, ...]
    lumens: float
    lumens_error: float
    paths: int

    def __str__(self) -> str:
        """Luminous flux and its standard error, both to the error's second digit."""
        error = self.lumens_error
        digits = max(0, 1 - math.floor(math.log10(error))) if error else 0
        return f"{self.lumens:,.{digits}f} ± {error:,.{digits}f} lm"


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissedFlux:
    """Share of the luminous flux that paths of at most `path_depth` bounces miss, one std. error.

    The reference are paths of at most `reference_depth` bounces.
    """

    path_depth: int
    reference_depth: int
    share: float
    error: float


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class PreviewResult(PictureResult):
    """A luminaire from six sides, and its figures.

    Attributes:
        luminaire: its name.
        triangles: of its meshes.
        emitters: shapes that emit.
        max_radiance: 99.99th percentile over the pixels of the views, W/(m² sr).
        size: sides of the bounding box, the luminaire's own unit.
        has_media: whether it holds participating media.
        flux: that leaves it.
        paths_per_second: speed of tracing.
        exposure: of the views on the sheet.
        faults: what cannot be rendered correctly, such as dielectrics that are not closed.
        bounces: what short paths miss; None where that was not asked for.
        sheet: file of the contact sheet; None where none was asked for.
    """

    luminaire: str
    triangles: int
    emitters: int
    max_radiance: float
    size: tuple[float, ...]
    has_media: bool
    flux: Flux
    paths_per_second: float
    exposure: float
    faults: list[str]
    sheet: Path | None
    bounces: list[MissedFlux] | None = None


def asset_json(asset: Asset, path: str | os.PathLike[str] | None) -> Json:
    """The figures of an asset, with its file where it has one."""
    info: Json = plain(asset.info)
    if path is None:
        return info
    return {"file": os.fspath(path), "file_bytes": Path(path).stat().st_size, **info}


def plain(value: Any) -> Any:
    """The value with paths as text, and all that holds others as lists and dictionaries."""
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return value.tolist()
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return plain({field.name: getattr(value, field.name) for field in fields})
    return value
