"""Table 2: terms of the loss, on `neoclassical`."""

import dataclasses
from typing import Any

import numpy as np

from benchmarks.paper_tables.cells import Cell, Found, Measured
from benchmarks.paper_tables.scales import Scale
from benchmarks.paper_tables.scoring import costs, first_views, score_network, test_views
from benchmarks.paper_tables.work import Work

LAMP = "neoclassical"
# Title, changes of the settings, and the paper's PSNR (dB), SSIM and RMSE of α.
VARIANTS: dict[str, tuple[str, dict[str, Any], tuple[float, float, float] | None]] = {
    "mse": (
        "MSE",
        {"colour_loss": "mse", "supervise_opacity": False},
        (19.8547, 0.6987, 0.3617),
    ),
    "regularized": (
        "MSE + regularizer",
        {"supervise_opacity": False},
        (28.1237, 0.9062, 0.1853),
    ),
    "opacity": ("MSE + regularizer + opacity loss", {}, (26.8784, 0.8829, 0.0358)),
    "mse-opacity": ("MSE + opacity loss", {"colour_loss": "mse"}, None),
    "geometric": (
        "as the paper, with its mask (`geometric`)",
        {"opacity_kind": "geometric"},
        None,
    ),
    "through": ("gradient through the denominator", {"stop_gradient": False}, None),
    "units": ("error in radiance units", {"colour_loss": "hdr_radiance"}, None),
}


def cells(scale: Scale) -> list[Cell]:
    """One for each variant."""
    return [
        Cell(
            f"2-{name}",
            2,
            {
                "lamp": LAMP,
                "train": scale.train,
                "test": scale.test,
                "network": dataclasses.replace(scale.network, **changes),
            },
            scale.minutes[0],
            lambda work, changes=changes: measure(work, changes),
        )
        for name, (_, changes, _) in VARIANTS.items()
    ]


def measure(work: Work, changes: dict[str, Any]) -> Measured:
    """A training with changed settings; the errors are the network's own, not its octree's."""
    run = work.run(LAMP, dataclasses.replace(work.scale.network, **changes))
    dataset = test_views(work, LAMP)
    scored = score_network(run.path, dataset)
    # The opacity, which the mask supervises, is compared with the mask as well.
    geometric = _rmse_of_masks(scored, dataset)
    values = {"metrics": scored.metrics, "opacity_rmse_geometric": geometric, "costs": costs(run)}
    return Measured(values, {"view": first_views(scored)})


def _rmse_of_masks(scored: Any, dataset: Any) -> float:
    """Mean over the views that the contact sheet may show, the first six at most."""
    squares = [
        float(np.mean((row.baked_opacity - view.geometric) ** 2))
        for row, view in zip(scored.rows, dataset.views(), strict=False)
    ]
    return float(np.mean(np.sqrt(squares)))


def section(found: Found) -> str:
    """Table and contact sheet."""
    heads = [
        "loss",
        "paper: PSNR",
        "SSIM",
        "RMSE of opacity",
        "ours: PSNR",
        "gain over black",
        "SSIM",
    ]
    heads += ["RMSE of opacity", "RMSE against the mask", "PSNR, μ-law"]
    rows = []
    for name, (title, _, paper) in VARIANTS.items():
        values = found.values(f"2-{name}")
        metrics = values.get("metrics", {})
        row = [title]
        row += (
            ["", "", ""] if paper is None else [f"{paper[0]:.2f}", *map("{:.3f}".format, paper[1:])]
        )
        row += [
            found.number(metrics.get("psnr_linear"), 2),
            found.number(metrics.get("gain_linear"), 2),
            found.number(metrics.get("ssim_linear"), 3),
            found.number(metrics.get("opacity_rmse"), 3),
            found.number(values.get("opacity_rmse_geometric"), 3),
            found.number(metrics.get("psnr_mulaw"), 2),
        ]
        rows.append(row)
    text = found.table(heads, rows)
    images = "".join(
        found.image(f"2-{name}", "view", f"{title}: reference and network")
        for name, (title, _, _) in VARIANTS.items()
    )
    return f"{text}\n{images}"
