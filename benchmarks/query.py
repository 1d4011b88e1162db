"""Time of a field query against that of a plain area light.

    python -m benchmarks query ASSET

Random lines through the proxy box, incoherent on purpose, for the asset and for deeper trees made
of it: of each leaf's eight children the four on one side of its middle are kept, as a surface would
keep them. In one run, interleaved, medians:

* area light: what Mitsuba does for the same rays where the lamp is a plain emissive cube, one
  intersection and one constant emission: the baseline;
* transmittance, emission: the queries;
* loads alone: about as many loads as an emission query makes, of random entries and leaves, without
  any traversal between them, for comparison.

Then the paper's thresholds, on the asset itself: their time and their error. Writes `query.md` and
`query.json`.
"""

import argparse
import dataclasses
import time
from collections.abc import Callable
from typing import Any

import numpy as np

from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import interleaved, kernel, ratios
from lumitree.asset.asset import Asset
from lumitree.asset.file import load
from lumitree.core.device import on_device
from lumitree.octree.build import MAX_TREE_DEPTH

NUM_RAYS = 1 << 19
ROUNDS = 7
BASELINE = "area light"
# min_density and max_opacity of the paper, each alone and both.
THRESHOLDS = ((0.0, 1.0), (0.1, 1.0), (0.0, 0.9), (0.1, 0.9))


def deepened(asset: Asset) -> Asset:
    """The asset one level deeper, four children for every leaf."""
    from lumitree.octree.build import build_children, child_cells
    from lumitree.octree.leaves import leaf_cells

    cells, levels = leaf_cells(asset.children, asset.num_leaves)
    # Planes of three orientations in turn.
    axis = np.arange(len(cells)) % 3
    octant = np.arange(8)
    kept = (octant[None] >> axis[:, None] & 1) == 0
    parent = np.repeat(np.arange(len(cells)), 8)[kept.ravel()]
    return dataclasses.replace(
        asset,
        children=build_children(child_cells(cells)[kept], levels[parent] + 1),
        density=2 * asset.density[parent],
        coefficients=asset.coefficients[parent],
        tree_depth=asset.tree_depth + 1,
    )


def random_lines(asset: Asset, count: int, seed: int) -> tuple[Any, Any]:
    """Origins and directions of lines through the proxy box."""
    import mitsuba as mi

    random = np.random.default_rng(seed)
    d = random.normal(size=(count, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = random.uniform(-1, 1, (count, 3)) * asset.frame.half_extents - 3 * d
    return on_device(mi.Point3f, o), on_device(mi.Vector3f, d)


def nanoseconds(jobs: dict[str, Callable[[], Any]], rays: int) -> dict[str, float]:
    """Time a ray of each job."""
    seconds = interleaved({name: kernel(job) for name, job in jobs.items()}, ROUNDS)
    return {name: each / rays * 1e9 for name, each in seconds.items()}


def visits(field: Any, origin: Any, direction: Any) -> tuple[float, float]:
    """Cells and leaves that a ray visits, on average."""
    import drjit as dr
    import mitsuba as mi

    octree, counts = field._octree, dr.zeros(mi.UInt32, 2)
    step = octree._step

    def counted(ray, t, cell, active):
        found = step(ray, t, cell, active)
        dr.scatter_reduce(dr.ReduceOp.Add, counts, mi.UInt32(1), mi.UInt32(0), active)
        leaf = active & (found[0] > 0)
        dr.scatter_reduce(dr.ReduceOp.Add, counts, mi.UInt32(1), mi.UInt32(1), leaf)
        return found

    octree._step = counted
    dr.eval(field.transmittance(origin, direction), counts)
    del octree._step
    rays = dr.width(origin)
    return float(counts[0]) / rays, float(counts[1]) / rays


def loads(field: Any, rays: int, cells: float, leaves: float) -> Callable[[], Any]:
    """Job: the loads of so many cells and leaves a ray at random places."""
    import drjit as dr
    import mitsuba as mi

    nodes, coefficients = field._octree._nodes, field._coefficients
    packets = dr.width(coefficients) // dr.width(field._density) // 4

    def job():
        place = dr.arange(mi.UInt32, rays) * 2654435761
        total = mi.UInt32(0)
        for table in nodes:
            for _ in range(round(cells)):
                place = place * 1664525 + 1013904223
                total += mi.UInt32(dr.gather(mi.Int32, table, place % dr.width(table)))
        for _ in range(round(leaves)):
            place = place * 1664525 + 1013904223
            leaf = place % dr.width(field._density)
            total += mi.UInt32(dr.gather(mi.Float, field._density, leaf))
            for packet in range(packets):
                total += dr.sum(dr.gather(mi.Vector4u, coefficients, leaf * packets + packet))
        return total

    return job


def measure_depth(asset: Asset, rays: int, seed: int) -> dict:
    """One row of the table by depth."""
    import drjit as dr
    import mitsuba as mi

    from lumitree.octree.field import Field

    start = time.perf_counter()
    field = Field(asset)
    dr.sync_thread()
    loaded = time.perf_counter() - start
    cube = mi.load_dict(
        {
            "type": "scene",
            "lamp": {
                "type": "cube",
                "to_world": mi.ScalarTransform4f().scale(asset.frame.half_extents.tolist()),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
        }
    )
    origin, direction = random_lines(asset, rays, seed)
    cells, leaves = visits(field, origin, direction)

    def area_light():
        si = cube.ray_intersect(mi.Ray3f(origin, direction))
        return si.emitter(cube).eval(si)

    times = nanoseconds(
        {
            BASELINE: area_light,
            "transmittance": lambda: field.transmittance(origin, direction),
            "emission": lambda: field.emission(origin, direction),
            "loads alone": loads(field, rays, cells, leaves),
        },
        rays,
    )
    arrays = [*field._octree._nodes, field._density, field._coefficients]
    device = sum(4 * dr.width(array) for array in arrays)
    file = asset.children.nbytes + asset.density.nbytes + asset.coefficients.nbytes
    a_leaf = 4 + 4 * dr.width(field._coefficients) // dr.width(field._density)
    return {
        "depth": asset.tree_depth,
        "leaves": asset.num_leaves,
        "cells_a_ray": cells,
        "leaves_a_ray": leaves,
        "bytes_a_ray": 4 * len(field._octree._nodes) * cells + a_leaf * leaves,
        "device_bytes": device,
        "device_over_file": device / file,
        "seconds_to_device": loaded,
        "nanoseconds": times,
        "over_area_light": ratios(times, BASELINE),
    }


def measure_thresholds(asset: Asset, rays: int, seed: int) -> list[dict]:
    """Time and error of the paper's thresholds."""
    from lumitree.octree.field import Field

    origin, direction = random_lines(asset, rays, seed)
    fields = {limits: Field(asset, *limits) for limits in THRESHOLDS}
    times = nanoseconds(
        {
            str(limits): (lambda field=field: field.emission(origin, direction))
            for limits, field in fields.items()
        },
        rays,
    )
    exact = fields[THRESHOLDS[0]].emission(origin, direction)
    rows = []
    for limits, field in fields.items():
        radiance, through = field.emission(origin, direction)
        true, shown = np.array(exact[0], np.float64), np.array(radiance, np.float64)
        rows.append(
            {
                "min_density": limits[0],
                "max_opacity": limits[1],
                "nanoseconds": times[str(limits)],
                "light": float(shown.sum() / true.sum()),
                "rmse_over_max": float(np.sqrt(((shown - true) ** 2).mean()) / asset.max_radiance),
                "opacity_rmse": float(np.sqrt(((np.array(through - exact[1])) ** 2).mean())),
            }
        )
    return rows


def depth_table(rows: list[dict]) -> Table:
    """A line for each depth."""
    heads = ["depth", "leaves", "cells a ray", "leaves a ray", "bytes a ray", "device MB"]
    heads += ["over file", "s to device", *(f"{name}, ns" for name in rows[0]["nanoseconds"])]
    lines = [
        [
            str(row["depth"]),
            f"{row['leaves']:,}",
            f"{row['cells_a_ray']:.1f}",
            f"{row['leaves_a_ray']:.1f}",
            f"{row['bytes_a_ray']:.0f}",
            f"{row['device_bytes'] / 1e6:.1f}",
            f"{row['device_over_file']:.2f}",
            f"{row['seconds_to_device']:.2f}",
            *(f"{value:.0f}" for value in row["nanoseconds"].values()),
            f"{row['over_area_light']['emission']:.1f}",
        ]
        for row in rows
    ]
    return Table([*heads, f"emission / {BASELINE}"], lines, left=0)


def threshold_table(rows: list[dict]) -> Table:
    """A line for each pair of thresholds."""
    heads = ["min_density", "max_opacity", "emission, ns", "light kept", "RMSE / asset's L_max"]
    lines = [
        [
            str(row["min_density"]),
            str(row["max_opacity"]),
            f"{row['nanoseconds']:.0f}",
            f"{row['light']:.4f}",
            f"{row['rmse_over_max']:.5f}",
            f"{row['opacity_rmse']:.4f}",
        ]
        for row in rows
    ]
    return Table([*heads, "opacity RMSE"], lines, left=0)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("asset", metavar="ASSET")
    parser.add_argument("--rays", type=int, metavar="N", default=NUM_RAYS, help="of each query")
    parser.add_argument(
        "--depth", type=int, metavar="D", default=MAX_TREE_DEPTH, help="of the deepest tree"
    )
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    asset = load(options.asset)
    results = Results(options, luminaire=asset.luminaire, rays=options.rays, baseline=BASELINE)
    thresholds = measure_thresholds(asset, options.rays, options.seed)
    print(threshold_table(thresholds).text(), flush=True)
    depths = [measure_depth(asset, options.rays, options.seed)]
    while asset.tree_depth < options.depth:
        asset = deepened(asset)
        depths.append(measure_depth(asset, options.rays, options.seed))
    print(depth_table(depths).text())
    facts = results.setting()
    tables = f"{depth_table(depths).markdown()}\n{threshold_table(thresholds).markdown()}"
    results.write(
        {"setting": facts, "thresholds": thresholds, "depths": depths},
        f"# A query\n\n{tables}\n{notes(facts)}",
    )
