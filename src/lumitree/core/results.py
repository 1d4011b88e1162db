"""Results of the functions of `lumitree`: frozen dataclasses for Python, JSON and notebooks."""

import dataclasses
import math
import os
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.backend import load_mitsuba
from lumitree.errors import shown
from lumitree.lamp.scene_shapes import SceneShape
from lumitree.measure.photometry.figures import PhotometricFigures
from lumitree.measure.photometry.near_field import NearFieldLimit

Json = dict[str, Any]


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class Result:
    """Base class of all results.

    Attributes:
        seconds: wall time by stage, s.
        peak_memory_bytes: largest resident memory of the process so far, bytes.
    """

    seconds: dict[str, float]
    peak_memory_bytes: int

    def to_json(self) -> Json:
        """Dictionary of the result, for `json.dumps`."""
        return {field.name: plain(getattr(self, field.name)) for field in self._shown()}

    def __repr__(self) -> str:
        lines = [f"{name}: {shown(value, 200)}" for name, value in self.to_json().items()]
        return "\n  ".join([type(self).__name__, *lines])

    def _shown(self) -> list[dataclasses.Field[Any]]:
        return [field for field in dataclasses.fields(self) if field.repr]


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class BakeResult(Result):
    """Result of a bake.

    Attributes:
        asset: the baked luminaire.
        path: file of the asset; None if none was written.
        irradiance: error of the irradiance around the asset: `irradiance_ratio`, `irradiance_rms`
            and `irradiance_rms_touching`, as in `EvaluateResult.metrics`, and `paths`,
            `ratio_error` and `faces`, as in `EvaluateResult.irradiance`. None if it was not
            compared: for a dataset, for 0 `irradiance_paths`, and after an interruption.
        held_out_psnr: PSNR on held-out rays, dB; None if no field was baked from
            rays.
        held_out_psnr_uncertainty: half the width of the 68 % interval of `held_out_psnr`, dB.
        rays: rays of the gradient descent, including those of the calls that this one continued;
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
        steps: number of steps, including those of earlier calls.
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


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class ImageResult(Result):
    """Base class of results with an image, which notebooks display.

    Attributes:
        png: contents of a PNG file with the image.
    """

    png: bytes = dataclasses.field(repr=False)

    def _repr_png_(self) -> bytes:
        return self.png


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class EvaluateResult(ImageResult):
    """Comparison of an asset with its luminaire: views, and the irradiance around it.

    Attributes:
        metrics: metrics by name, as means over the views; the gains over black, in dB, are
            `gain_linear` and `gain_mulaw`. If the irradiance was compared, also `irradiance_ratio`:
            flux through a cube of three times the luminaire's size, baked over explicit;
            `irradiance_rms`: relative RMS error of the irradiance, mean over the cube's six faces;
            and `irradiance_rms_touching`: the same on a plane that touches the bounding box from
            below. One whose reference is too noisy, or dark, is omitted.
        max_radiance: L_max of the views, W/(m² sr), by which the metrics divide radiance; None if
            there are no views, because the asset was compared with another one.
        views: metrics by name, of each view.
        asset: `Asset.info` as a dictionary, and file and size in bytes if the asset is a file.
        sheet: file of the contact sheet; None if none was written.
        irradiance: `paths`, traced for each of both sides; `ratio_error`, the standard error of
            `irradiance_ratio`; and `faces`: for each of "-x", "+x", "-y", "+y", "-z", "+z" and
            "touching" the mean illuminance `explicit_lux` and `baked_lux`, lx, their `ratio` and
            the relative `rms` error, with the standard errors `ratio_error` and `rms_error`. None
            if the irradiance was not compared.
        irradiance_sheet: file of the irradiance in false colour; None if none was written.
        irradiance_png: this image, as the bytes of a PNG file; None if it was not made.
    """

    metrics: dict[str, float]
    max_radiance: float | None
    views: list[dict[str, Any]]
    asset: Json
    sheet: Path | None
    irradiance: Json | None = None
    irradiance_sheet: Path | None = None
    irradiance_png: bytes | None = dataclasses.field(default=None, repr=False)


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class RenderResult(ImageResult):
    """Rendered image of a scene.

    Attributes:
        pixels: float32 [height, width, 3], linear radiance, W/(m² sr).
        image: file of the image; None if none was written.
        resolution: width and height in pixels.
        samples_per_pixel: samples per pixel.
        mean_radiance: mean over pixels and channels, W/(m² sr).
        noise: estimated standard error of the pixels before denoising: its sum over all pixels,
            relative to the sum of their radiance. None if there was one pass only.
        layers: file of the layers; None if none was written.
        aov: file of albedo and normal; None if none was written.
    """

    pixels: NDArray[np.float32] = dataclasses.field(repr=False)
    image: Path | None
    resolution: tuple[int, int]
    samples_per_pixel: int
    mean_radiance: float
    noise: float | None = None
    layers: Path | None = None
    aov: Path | None = None


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class MixResult(ImageResult):
    """Image that was mixed from layers.

    Attributes:
        pixels: float32 [height, width, 3], linear radiance, W/(m² sr).
        image: file of the image; None if none was written.
        layers: names of the layers.
        resolution: width and height in pixels.
        mean_radiance: mean over pixels and channels, W/(m² sr).
    """

    pixels: NDArray[np.float32] = dataclasses.field(repr=False)
    image: Path | None
    layers: list[str]
    resolution: tuple[int, int]
    mean_radiance: float


@dataclasses.dataclass(frozen=True, kw_only=True)
class Flux:
    """Estimate of the flux that leaves a luminaire, for lengths in metres.

    Attributes:
        watts: radiant flux of R, G and B, W.
        watts_error: standard errors of `watts`, W.
        lumens: luminous flux, lm.
        lumens_error: standard error of `lumens`, lm.
        paths: number of light paths of the estimate.
    """

    watts: tuple[float, ...]
    watts_error: tuple[float, ...]
    lumens: float
    lumens_error: float
    paths: int

    def __str__(self) -> str:
        """Luminous flux ± standard error, rounded to two significant digits of the error."""
        error = self.lumens_error
        digits = max(0, 1 - math.floor(math.log10(error))) if error else 0
        return f"{self.lumens:,.{digits}f} ± {error:,.{digits}f} lm"


@dataclasses.dataclass(frozen=True, kw_only=True)
class MissedFlux:
    """Share of the luminous flux that paths of limited length miss.

    Attributes:
        path_depth: largest number of bounces.
        reference_depth: largest number of bounces of the paths that are compared with.
        share: share of the flux, 0 to 1.
        error: standard error of `share`.
    """

    path_depth: int
    reference_depth: int
    share: float
    error: float


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class PreviewResult(ImageResult):
    """Figures of a luminaire, and its views from six sides.

    Attributes:
        luminaire: name of the luminaire.
        triangles: number of triangles of its meshes.
        emitters: number of shapes that emit.
        max_radiance: L_max, the 99.99th percentile over the pixels of the views, W/(m² sr).
        size: [3] sides of the bounding box, in the unit of the luminaire's file.
        has_media: whether there are participating media.
        flux: flux that leaves the luminaire.
        paths_per_second: speed of path tracing.
        exposure: factor on the radiance in the first row of the contact sheet.
        faults: one line for each fault that cannot be rendered correctly, such as a dielectric that
            is not closed.
        bounces: share of the flux that short paths miss; None if it was not measured.
        sheet: file of the contact sheet; None if none was written.
        shapes: its shapes, with `number`, `name` (id), and `materials` (ids of BSDFs, names of
            materials), by which `keep` and `drop` find them; and with their plugins, `kind`, `bsdf`
            and `emitter`.
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
    shapes: tuple[SceneShape, ...] = ()


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class AssetPreviewResult(ImageResult):
    """Figures of an asset, and its views from six sides.

    Attributes:
        luminaire: name of the luminaire.
        parts: which of "exitant", "field" and "model" it has.
        leaves: number of leaves of its field.
        size: [3] sides of the bounding box, in the unit of the luminaire's file.
        watts: [3] flux that it emits, R, G and B, W, if lengths are in metres: exact with an
            exitant light field, else estimated from 2²⁰ rays.
        lumens: the same as luminous flux, lm.
        exposure: factor on the radiance in the first row of the contact sheet.
        sheet: file of the contact sheet; None if none was written.
    """

    luminaire: str
    parts: tuple[str, ...]
    leaves: int
    size: tuple[float, ...]
    watts: tuple[float, ...]
    lumens: float
    exposure: float
    sheet: Path | None


@dataclasses.dataclass(frozen=True, repr=False, kw_only=True)
class PhotometryResult(ImageResult, PhotometricFigures):
    """Result of a photometric measurement: the figures of `PhotometricFigures`, and more.

    `png` shows a polar plot and an isocandela plot.

    Attributes:
        luminaire: name of the luminaire.
        near_field: for some directions, the distance from which the far field is within 5 %.
        step: of the angles, degrees.
        size: [3] sides of the bounding box, m.
        rays: number of light paths, or of rays of an asset.
        c_angles, gamma_angles: [C] and [G] angles of the intensities, degrees.
        intensity, intensity_error: [C, G] luminous intensities and standard errors, cd.
        files: files that were written.
        ugr: [19, 10] Unified Glare Ratings, see `measure.photometry.ugr.ugr_table`; NaN where there is
            none. None if the optional dependency `ugr` is not installed.
    """

    luminaire: str
    near_field: list[NearFieldLimit]
    step: float
    size: tuple[float, ...]
    rays: int
    c_angles: NDArray[np.float64] = dataclasses.field(repr=False)
    gamma_angles: NDArray[np.float64] = dataclasses.field(repr=False)
    intensity: NDArray[np.float64] = dataclasses.field(repr=False)
    intensity_error: NDArray[np.float64] = dataclasses.field(repr=False)
    files: list[Path]
    ugr: NDArray[np.float64] | None = dataclasses.field(default=None, repr=False)


def asset_json(asset: Asset, path: str | os.PathLike[str] | None) -> Json:
    """`Asset.info` as a dictionary, with `file` and `file_bytes` if `path` is not None."""
    info: Json = plain(asset.info)
    if path is None:
        return info
    return {"file": os.fspath(path), "file_bytes": Path(path).stat().st_size, **info}


def asset_report(asset: Asset, path: str | os.PathLike[str]) -> Json:
    """What `lumitree info` states: `asset_json`, and the luminous flux, lm, for metres."""
    from lumitree.render.asset_flux import asset_lumens

    if asset.exitant is None:
        # Estimated by rays; else a sum that needs no variant of Mitsuba, and so no libLLVM.
        load_mitsuba()
    return {**asset_json(asset, path), "lumens": asset_lumens(asset)}


def plain(value: Any) -> Any:
    """Convert a value for `json.dumps`: paths to text, arrays and tuples to lists, and so on.

    Numbers that JSON does not have, NaN and infinities, become None.
    """
    if isinstance(value, float) and not math.isfinite(value):
        return None
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    if isinstance(value, dict):
        return {str(key): plain(item) for key, item in value.items()}
    if isinstance(value, tuple | list):
        return [plain(item) for item in value]
    if isinstance(value, np.ndarray | np.generic):
        return plain(value.tolist())
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        fields = dataclasses.fields(value)
        return plain({field.name: getattr(value, field.name) for field in fields})
    return value
