"""Table 1: reconstruction of the five stand-ins, by the paper's method and by the octree fit."""

from typing import Any

from benchmarks.paper_tables.cells import Cell, Found, Measured
from benchmarks.paper_tables.scales import LAMPS, Scale
from benchmarks.paper_tables.scoring import (
    bytes_of,
    costs,
    first_views,
    large_views,
    of_first_views,
    score_asset,
    score_network,
    test_views,
)
from benchmarks.paper_tables.work import Work
from lumitree.asset.file import load
from lumitree.measure.metrics import METRICS

# PSNR (dB) and SSIM of the paper's Table 1.
PAPER = {
    "dallas": (31.5072, 0.9374),
    "portica": (28.6694, 0.8594),
    "cluster": (27.7260, 0.8872),
    "neoclassical": (26.8784, 0.8829),
    "star": (27.8027, 0.9119),
}
METHODS = {"network": "network", "octree": "octree of the network", "direct": "octree fit"}


def cells(scale: Scale) -> list[Cell]:
    """For each lamp the network with its octree, and the octree fit."""
    training, baking, capture = scale.minutes
    views = {"train": scale.train, "test": scale.test, "large": scale.large}
    network = views | {"network": scale.network, "depth": scale.network_depth}
    network |= {"samples_per_leaf": scale.samples_per_leaf}
    direct = {"test": scale.test, "large": scale.large, "direct": scale.direct}
    found = []
    for lamp in scale.lamps:
        found.append(
            Cell(
                f"1-{lamp}-network",
                1,
                {"lamp": lamp, **network},
                training + capture,
                lambda work, lamp=lamp: measure_network(work, lamp),
            )
        )
        found.append(
            Cell(
                f"1-{lamp}-direct",
                1,
                {"lamp": lamp, **direct},
                baking + capture,
                lambda work, lamp=lamp: measure_direct(work, lamp),
            )
        )
    return found


def measure_network(work: Work, lamp: str) -> Measured:
    """The network by itself, and its octree."""
    run = work.run(lamp, work.scale.network)
    asset = work.network_asset(lamp, work.scale.network)
    views, large = test_views(work, lamp), large_views(work, lamp)
    by_network, by_octree = score_network(run.path, views), score_asset(asset.path, views)
    built = work.views(lamp, work.scale.train, "train"), run, asset
    values: dict[str, Any] = {
        "network": by_network.metrics,
        "octree": by_octree.metrics,
        "octree_few": of_first_views(by_octree, work.scale.large.count),
        "octree_large": score_asset(asset.path, large).metrics,
        "bytes": bytes_of(asset),
        "leaves": load(asset.path).num_leaves,
        "costs": costs(*built),
        "peak_memory_bytes": max(each.peak_memory_bytes for each in built),
    }
    return Measured(values, {"view": first_views(by_network, by_octree)})


def measure_direct(work: Work, lamp: str) -> Measured:
    """The octree fit."""
    asset = work.direct_asset(lamp, work.scale.direct)
    scored = score_asset(asset.path, test_views(work, lamp))
    values: dict[str, Any] = {
        "direct": scored.metrics,
        "direct_few": of_first_views(scored, work.scale.large.count),
        "direct_large": score_asset(asset.path, large_views(work, lamp)).metrics,
        "bytes": bytes_of(asset),
        "leaves": load(asset.path).num_leaves,
        "costs": costs(asset) | {"stages": asset.details["stages"]},
        "peak_memory_bytes": asset.peak_memory_bytes,
    }
    return Measured(values, {"view": first_views(scored)})


def values_of(found: Found, lamp: str) -> dict[str, Any]:
    """All values of a lamp, of both cells."""
    return found.values(f"1-{lamp}-network") | found.values(f"1-{lamp}-direct")


def section(found: Found) -> str:
    """Tables of this section of the page, and its images."""
    heads = ["lamp", "paper: PSNR", "SSIM"]
    for title in ("black", *METHODS.values()):
        heads += [f"{title}: PSNR"] if title == "black" else [f"{title}: PSNR", "SSIM"]
    rows = []
    for lamp in LAMPS:
        values = values_of(found, lamp)
        row = [lamp, f"{PAPER[lamp][0]:.2f}", f"{PAPER[lamp][1]:.3f}"]
        black = values.get("octree") or values.get("direct") or {}
        row.append(found.number(black.get("psnr_linear_black"), 2))
        for method in METHODS:
            metrics = values.get(method, {})
            row.append(found.number(metrics.get("psnr_linear"), 2))
            row.append(found.number(metrics.get("ssim_linear"), 3))
        rows.append(row)
    text = found.table(heads, rows)
    if found.has(*(f"1-{lamp}-{kind}" for lamp in LAMPS for kind in ("network", "direct"))):
        text += f"\n{_large(found)}\n{_all_metrics(found)}\n{_images(found)}"
    return text


def _large(found: Found) -> str:
    rows = []
    for lamp in LAMPS:
        values, row = values_of(found, lamp), [lamp]
        for method in ("octree", "direct"):
            for suffix in ("_few", "_large"):
                metrics = values.get(method + suffix, {})
                row.append(found.number(metrics.get("psnr_linear"), 2))
                row.append(found.number(metrics.get("gain_linear"), 2))
        rows.append(row)
    small, large = (f"{views.resolution}²" for views in (found.scale.test, found.scale.large))
    heads = ["lamp"]
    for method in ("octree", "direct"):
        for size in (small, large):
            heads += [f"{METHODS[method]}, {size}: PSNR", "gain over black"]
    count = found.scale.large.count
    text = f"The effect of the views' resolution, on the first {count} views"
    return f"{text}:\n\n{found.table(heads, rows)}"


def _all_metrics(found: Found) -> str:
    rows = []
    for lamp in LAMPS:
        values = values_of(found, lamp)
        for method, title in METHODS.items():
            if method in values:
                metrics = values[method]
                numbers = [found.number(metrics.get(name), 4) for name in METRICS]
                rows.append([lamp, title, *numbers])
    table = found.table(["lamp", "method", *METRICS], rows, 2)
    return f"All [image metrics](../../docs/decisions/metrics.md#image-metrics):\n\n{table}"


def _images(found: Found) -> str:
    text = "The first held-out view: reference, network and its octree, opacities below; then the "
    text += "reference and the octree fit.\n\n"
    for lamp in LAMPS:
        for kind in ("network", "direct"):
            text += found.image(f"1-{lamp}-{kind}", "view", f"{lamp}, {kind}")
    return text
