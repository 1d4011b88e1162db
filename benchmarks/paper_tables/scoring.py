"""Errors of networks and assets on held-out views."""

import dataclasses
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.paper_tables.pictures import views as picture
from benchmarks.paper_tables.work import Built, Work
from lumitree.asset.file import load
from lumitree.core.frames import orthographic_rays
from lumitree.lamp.dataset import Dataset, Frame

if TYPE_CHECKING:
    from lumitree.fit.network.trained_field import TrainedField
    from lumitree.measure.evaluate import Evaluation


def test_views(work: Work, lamp: str) -> Dataset:
    """Held-out views of a lamp."""
    return Dataset.open(work.views(lamp, work.scale.test, "test").path)


def large_views(work: Work, lamp: str) -> Dataset:
    """Held-out views of a lamp at the paper's resolution."""
    return Dataset.open(work.views(lamp, work.scale.large, "test").path)


def score_asset(asset: Path, dataset: Dataset) -> "Evaluation":
    """Errors of the field of an asset, by the renderer's exact traversal."""
    from lumitree.measure.evaluate import evaluate_views

    return evaluate_views(load(asset), dataset)


def score_network(run: Path, dataset: Dataset) -> "Evaluation":
    """Errors of the networks themselves, by a ray through each pixel's centre, as in training."""
    from lumitree.fit.network.trained_field import load_field
    from lumitree.measure.evaluate import compare_views

    field = load_field(run)
    return compare_views(lambda frame: network_view(field, dataset, frame), dataset)


def network_view(
    field: "TrainedField", dataset: Dataset, frame: Frame
) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Radiance [H, W, 3] and opacity [H, W] of a view by a network."""
    manifest = dataset.manifest
    origins, direction = orthographic_rays(frame.pose, manifest.half_width, manifest.resolution)
    radiance, opacity = field.render(origins, direction)
    return radiance.reshape(origins.shape), opacity.reshape(origins.shape[:2])


def of_first_views(scored: "Evaluation", count: int) -> dict[str, float]:
    """Means over the first views alone, and the gains over black."""
    from lumitree.measure.metrics import gain_over_black, mean_metrics

    means = mean_metrics([view.metrics for view in scored.rows[:count]])
    return means | gain_over_black(means)


def first_views(*scored: "Evaluation") -> NDArray[np.uint8]:
    """The first held-out view: the reference, and what each has in its place; opacities below."""
    rows = [each.rows[0] for each in scored]
    return picture(
        [rows[0].reference, *(row.baked for row in rows)],
        [rows[0].reference_opacity, *(row.baked_opacity for row in rows)],
    )


def costs(*built: Built) -> dict[str, Any]:
    """Seconds of what a cell is made of, by its folder's name without the hash."""
    return {each.path.parent.name.rpartition("-")[0]: round(each.seconds, 1) for each in built}


def bytes_of(asset: Built) -> int:
    """Size of an asset's field alone, as a file holds it."""
    found = load(asset.path)
    alone = dataclasses.replace(found, light_field=None, geometry=None)
    return alone.children.nbytes + alone.density.nbytes + alone.coefficients.nbytes
