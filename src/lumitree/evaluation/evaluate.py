"""All metrics of a baked luminaire on the held-out views of a dataset."""

import dataclasses
from typing import Any

from lumitree.asset.asset import Asset
from lumitree.core.dataset import Dataset
from lumitree.core.progress import progress
from lumitree.errors import LumitreeError
from lumitree.evaluation.baked import baked_view
from lumitree.evaluation.metrics import flux_error, mean_metrics, view_metrics
from lumitree.evaluation.sheet import MAX_ROWS, SheetRow
from lumitree.octree.field import shared_field


@dataclasses.dataclass(frozen=True)
class Evaluation:
    """Means over views, each view's own metrics, and what a contact sheet shows.

    Attributes:
        max_radiance: L_max of the views compared with.
    """

    max_radiance: float
    metrics: dict[str, float]
    views: list[dict[str, Any]]
    rows: list[SheetRow]


def evaluate_views(asset: Asset, dataset: Dataset) -> Evaluation:
    """Compare an asset with every view of `dataset`.

    The opacity compared is `straight_through`: what the renderer multiplies the light behind
    with (D7).

    Raises:
        LumitreeError: the dataset shows a luminaire of other proportions, or nothing.
    """
    manifest = dataset.manifest
    if any(
        abs(own - other) > 1e-3
        for own, other in zip(asset.half_extents, manifest.half_extents, strict=True)
    ):
        raise LumitreeError(
            f"the asset ({asset.luminaire}) and {dataset.folder} ({manifest.luminaire}) have "
            "bounding boxes of different proportions; evaluate an asset on its own luminaire"
        )
    field = shared_field(asset)
    # Of the views, so that assets with other bounds are compared on one scale.
    max_radiance = dataset.max_radiance(dataset.views())
    views, rows = [], []
    with progress("evaluate", len(manifest.frames)) as advance:
        for view in dataset.views():
            radiance, opacity = baked_view(field, manifest, view.frame)
            metrics = view_metrics(
                radiance, view.radiance, opacity, view.straight_through, max_radiance
            )
            views.append({"halton_index": view.frame.halton_index, **metrics})
            name = f"view {view.frame.halton_index}"
            rows.append(
                SheetRow(name, view.radiance, radiance, view.straight_through, opacity, metrics)
            )
            advance(1)
    metrics = mean_metrics([row.metrics for row in rows])
    metrics["flux_error"] = flux_error([row.baked for row in rows], [row.reference for row in rows])
    return Evaluation(max_radiance, metrics, views, rows[:MAX_ROWS])
