"""All metrics of a baked luminaire: on held-out views, and of the irradiance around it."""

import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.dataset import Dataset, Frame, OpacityKind
from lumitree.core.progress import progress
from lumitree.errors import LumitreeError
from lumitree.lamp.luminaire import Luminaire
from lumitree.measure.irradiance import (
    FACES,
    Irradiance,
    IrradianceError,
    asset_irradiance,
    irradiance_error,
    luminaire_irradiance,
)
from lumitree.measure.metrics import (
    flux_error,
    gain_over_black,
    mean_metrics,
    view_metrics,
)
from lumitree.output.sheet import MAX_ROWS, SheetRow
from lumitree.rendering.asset_images import GeometryCamera
from lumitree.rendering.asset_views import baked_view

Predict = Callable[[Frame], tuple[NDArray[np.floating], NDArray[np.floating]]]


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Metrics of an asset on the views of a dataset.

    Attributes:
        max_radiance: L_max of the dataset's views, W/(m² sr).
        metrics: means over the views, `flux_error`, and the gains over black, by name.
        views: metrics of each view, with its `halton_index`.
        rows: images for a contact sheet.
    """

    max_radiance: float
    metrics: dict[str, float]
    views: list[dict[str, Any]]
    rows: list[SheetRow]


def evaluate_views(asset: Asset, dataset: Dataset) -> Evaluation:
    """Compare an asset with every view of `dataset`.

    What is compared is the radiance field. Of an asset without one it is the geometry, by as many
    paths a pixel as the views have, and its `geometric` opacity; or else the light field.

    Raises:
        LumitreeError: the dataset shows a luminaire of other proportions, or nothing.
    """
    manifest = dataset.manifest
    if np.abs(asset.frame.half_extents - manifest.local_frame.half_extents).max() > 1e-3:
        raise LumitreeError(
            f"the asset ({asset.luminaire}) and {dataset.folder} ({manifest.luminaire}) have "
            "bounding boxes of different proportions; evaluate an asset on its own luminaire"
        )
    if asset.num_leaves or asset.geometry is None:
        return compare_views(lambda frame: baked_view(asset, manifest, frame), dataset)
    camera = GeometryCamera(asset, manifest.half_width, manifest.resolution)
    samples = manifest.samples_per_pixel
    return compare_views(
        lambda frame: camera.take(frame.pose, samples, frame.halton_index, "view"),
        dataset,
        "geometric",
    )


def compare_views(
    predict: Predict, dataset: Dataset, opacity_kind: OpacityKind = "straight_through"
) -> Evaluation:
    """Compare images with every view of `dataset`.

    Args:
        predict: returns radiance [H, W, 3] and opacity [H, W] of a view.
        opacity_kind: the opacity that is compared. By default that of a field: the renderer
            multiplies the light behind the luminaire by 1 minus this opacity.

    Raises:
        LumitreeError: the dataset shows nothing.
    """
    # L_max of the views, not of the asset, so that all assets are compared on one scale.
    max_radiance = dataset.max_radiance(dataset.views())
    views, rows = [], []
    with progress("evaluate", len(dataset.manifest.frames)) as advance:
        for view in dataset.views():
            radiance, opacity = predict(view.frame)
            expected = view.opacity(opacity_kind)
            metrics = view_metrics(radiance, view.radiance, opacity, expected, max_radiance)
            views.append({"halton_index": view.frame.halton_index, **metrics})
            name = f"view {view.frame.halton_index}"
            rows.append(SheetRow(name, view.radiance, radiance, expected, opacity, metrics))
            advance(1)
    metrics = mean_metrics([row.metrics for row in rows])
    metrics["flux_error"] = flux_error([row.baked for row in rows], [row.reference for row in rows])
    metrics |= gain_over_black(metrics)
    return Evaluation(max_radiance, metrics, views, rows[:MAX_ROWS])


@dataclasses.dataclass(frozen=True)
class IrradianceEvaluation:
    """Irradiance around an asset, compared with that around its luminaire.

    Attributes:
        num_paths: light paths of the luminaire, and rays of the asset.
        explicit, baked: estimates for what is compared with, and for the asset.
        error: of `baked`.
    """

    num_paths: int
    explicit: Irradiance
    baked: Irradiance
    error: IrradianceError

    @property
    def metrics(self) -> dict[str, float]:
        """`irradiance_ratio`, `irradiance_rms` and `irradiance_rms_touching`.

        One that is not defined (see `IrradianceError`) is omitted.
        """
        values = {
            "irradiance_ratio": self.error.total_ratio,
            "irradiance_rms": self.error.mean_rms,
            "irradiance_rms_touching": float(self.error.rms[FACES.index("touching")]),
        }
        return {name: value for name, value in values.items() if math.isfinite(value)}

    def report(self) -> dict[str, Any]:
        """Values for JSON.

        Returns:
            `paths`; `ratio_error`, the standard error of `irradiance_ratio`; and `faces`: for each
            of `FACES` the means `explicit_lux` and `baked_lux`, `ratio`, `ratio_error`, `rms` and
            `rms_error`. What is not defined (see `IrradianceError`) is None.
        """
        columns = {
            "explicit_lux": self.explicit.lux.mean(axis=(1, 2)),
            "baked_lux": self.baked.lux.mean(axis=(1, 2)),
            "ratio": self.error.ratio,
            "ratio_error": self.error.ratio_error,
            "rms": self.error.rms,
            "rms_error": self.error.rms_error,
        }
        faces = {
            face: {name: _finite(values[index]) for name, values in columns.items()}
            for index, face in enumerate(FACES)
        }
        return {
            "paths": self.num_paths,
            "ratio_error": _finite(self.error.total_ratio_error),
            "faces": faces,
        }


def evaluate_irradiance(
    asset: Asset, reference: Luminaire | Asset, num_paths: int
) -> IrradianceEvaluation:
    """Compare the irradiance around an asset with that around its luminaire.

    Args:
        reference: the luminaire, or another asset. It must have a bounding box of the asset's
            proportions, which `evaluate_views` checks.
        num_paths: light paths of the luminaire, and as many rays of the asset.

    Raises:
        LumitreeError: a path's flux is NaN or infinite.
    """
    if isinstance(reference, Asset):
        # Another seed than that of `asset`: the two estimates are independent.
        explicit = asset_irradiance(reference, num_paths, seed=1)
    else:
        explicit = luminaire_irradiance(reference, num_paths)
    baked = asset_irradiance(asset, num_paths)
    return IrradianceEvaluation(num_paths, explicit, baked, irradiance_error(baked, explicit))


def _finite(value: float) -> float | None:
    """The value; None if it is NaN or infinite, which JSON does not have."""
    return float(value) if math.isfinite(value) else None
