"""Metrics of a baked luminaire on held-out views."""

import dataclasses
from collections.abc import Callable
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.frames import LocalFrame
from lumitree.core.progress import progress
from lumitree.errors import LumitreeError, shown
from lumitree.lamp.dataset import Dataset, Frame, OpacityKind
from lumitree.measure.figures import MAX_ROWS, SheetRow
from lumitree.measure.metrics import (
    flux_error,
    gain_over_black,
    mean_metrics,
    view_metrics,
)
from lumitree.rendering.asset_images import geometry_camera
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


def check_proportions(asset: Asset, frame: LocalFrame, name: str) -> None:
    """Refuse a luminaire whose bounding box has other proportions than an asset's."""
    if np.abs(asset.frame.half_extents - frame.half_extents).max() > 1e-3:
        raise LumitreeError(
            f"the asset ({shown(asset.luminaire, 200)}) and {shown(name, 200)} have bounding "
            "boxes of different proportions; evaluate an asset on its own luminaire"
        )


def evaluate_views(asset: Asset, dataset: Dataset) -> Evaluation:
    """Compare an asset with every view of `dataset`.

    The radiance field is compared. For an asset without one it is the geometry, by as many
    paths a pixel as the views have, and its `geometric` opacity; or else the light field.

    Raises:
        LumitreeError: the dataset shows a luminaire of other proportions, or nothing.
    """
    manifest = dataset.manifest
    check_proportions(asset, manifest.local_frame, manifest.luminaire)
    if asset.num_leaves or asset.geometry is None:
        return compare_views(lambda frame: baked_view(asset, manifest, frame), dataset)
    camera = geometry_camera(asset, manifest.half_width, manifest.resolution)
    samples = manifest.spp
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
