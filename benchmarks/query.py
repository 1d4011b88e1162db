"""Time of a field query: python benchmarks/query.py ASSET [--write]

Random lines through the proxy box, incoherent on purpose, for the asset and for deeper trees made
of it: of each leaf's eight children the four on one side of its middle are kept, as a surface would
keep them. In one run, interleaved, medians:

* area light: what Mitsuba does for the same rays where the lamp is a plain emissive cube, one
  intersection and one constant emission: the baseline;
* transmittance, emission: the queries;
* loads alone: about as many loads as an emission query makes, of random entries and leaves, without
  any walk between them: a yardstick.

Then the paper's thresholds, on the asset itself: their time and their error. `--write` puts
`query.md` and `query.json` into benchmarks/results/.
"""

import argparse
import dataclasses
import statistics
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from lumitree.asset.asset import Asset
from lumitree.asset.file import load
from lumitree.core.backend import load_mitsuba
from lumitree.core.files import atomic_path, write_json
from lumitree.octree.build import MAX_TREE_DEPTH
from setting import setting

RESULTS = Path(__file__).parent / "results"
NUM_RAYS = 1 << 19
ROUNDS = 7
# min_density and max_opacity of the paper, each alone and both.
THRESHOLDS = ((0.0, 1.0), (0.1, 1.0), (0.0, 0.9), (0.1, 0.9))


def deepened(asset: Asset) -> Asset:
    """The asset one level deeper, four children for every leaf."""
    from lumitree.direct.estimate import split
    from lumitree.octree.build import build_children
    from lumitree.octree.leaves import leaf_cells

    cells, levels = leaf_cells(asset.children, asset.num_leaves)
    # Planes of three orientations in turn.
    axis = np.arange(len(cells)) % 3
    octant = np.arange(8)
    kept = (octant[None] >> axis[:, None] & 1) == 0
    parent = np.repeat(np.arange(len(cells)), 8)[kept.ravel()]
    return dataclasses.replace(
        asset,
        children=build_children(split(cells)[kept.ravel()], levels[parent] + 1),
        density=2 * asset.density[parent],
        coefficients=asset.coefficients[parent],
        tree_depth=asset.tree_depth + 1,
    )


def random_lines(asset: Asset) -> tuple[Any, Any]:
    """Origins and directions of lines through the proxy box."""
    import mitsuba as mi

    random = np.random.default_rng(0)
    d = random.normal(size=(NUM_RAYS, 3))
    d /= np.linalg.norm(d, axis=1, keepdims=True)
    o = random.uniform(-1, 1, (NUM_RAYS, 3)) * asset.half_extents - 3 * d
    return mi.Point3f(o.T), mi.Vector3f(d.T)


def measure(jobs: dict[str, Callable[[], Any]]) -> dict[str, float]:
    """Nanoseconds a ray of each job: medians of interleaved rounds, compilation apart."""
    import drjit as dr

    times: dict[str, list[float]] = {name: [] for name in jobs}
    for _ in range(ROUNDS + 1):
        for name, job in jobs.items():
            result = job()
            dr.sync_thread()
            start = time.perf_counter()
            dr.eval(result)
            dr.sync_thread()
            times[name].append((time.perf_counter() - start) / NUM_RAYS * 1e9)
    return {name: statistics.median(values[1:]) for name, values in times.items()}


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
    return float(counts[0]) / NUM_RAYS, float(counts[1]) / NUM_RAYS


def loads(field: Any, cells: float, leaves: float) -> Callable[[], Any]:
    """Job: the loads of so many cells and leaves a ray at random places."""
    import drjit as dr
    import mitsuba as mi

    nodes, coefficients = field._octree._nodes, field._coefficients
    packets = dr.width(coefficients) // dr.width(field._density) // 4

    def job():
        place = dr.arange(mi.UInt32, NUM_RAYS) * 2654435761
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


def measure_depth(asset: Asset) -> dict:
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
                "to_world": mi.ScalarTransform4f().scale(asset.half_extents.tolist()),
                "emitter": {"type": "area", "radiance": {"type": "rgb", "value": 1.0}},
            },
        }
    )
    origin, direction = random_lines(asset)
    cells, leaves = visits(field, origin, direction)

    def area_light():
        si = cube.ray_intersect(mi.Ray3f(origin, direction))
        return si.emitter(cube).eval(si)

    times = measure(
        {
            "area light": area_light,
            "transmittance": lambda: field.transmittance(origin, direction),
            "emission": lambda: field.emission(origin, direction),
            "loads alone": loads(field, cells, leaves),
        }
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
    }


def measure_thresholds(asset: Asset) -> list[dict]:
    """Time and error of the paper's thresholds."""
    from lumitree.octree.field import Field

    origin, direction = random_lines(asset)
    fields = {limits: Field(asset, *limits) for limits in THRESHOLDS}
    times = measure(
        {
            str(limits): (lambda field=field: field.emission(origin, direction))
            for limits, field in fields.items()
        }
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


def table(report: dict) -> str:
    """Both tables in Markdown."""
    heads = (
        "depth, leaves, cells a ray, leaves a ray, bytes a ray, device MB, over file, s to device"
    )
    names = list(report["depths"][0]["nanoseconds"])
    heads = heads.split(", ") + [f"{name}, ns" for name in names] + ["emission / area light"]
    lines = ["| " + " | ".join(heads) + " |", "|---:" * len(heads) + "|"]
    for row in report["depths"]:
        times = row["nanoseconds"]
        cells = [
            str(row["depth"]),
            f"{row['leaves']:,}",
            f"{row['cells_a_ray']:.1f}",
            f"{row['leaves_a_ray']:.1f}",
            f"{row['bytes_a_ray']:.0f}",
            f"{row['device_bytes'] / 1e6:.1f}",
            f"{row['device_over_file']:.2f}",
            f"{row['seconds_to_device']:.2f}",
            *(f"{value:.0f}" for value in times.values()),
            f"{times['emission'] / times['area light']:.1f}",
        ]
        lines.append("| " + " | ".join(cells) + " |")
    heads = [
        "min_density",
        "max_opacity",
        "emission, ns",
        "light kept",
        "RMSE / asset's L_max",
        "opacity RMSE",
    ]
    lines += ["", "| " + " | ".join(heads) + " |", "|---:" * len(heads) + "|"]
    for row in report["thresholds"]:
        lines.append(
            f"| {row['min_density']} | {row['max_opacity']} | {row['nanoseconds']:.0f} | "
            f"{row['light']:.4f} | {row['rmse_over_max']:.5f} | {row['opacity_rmse']:.4f} |"
        )
    return "\n".join(lines) + "\n"


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("asset", metavar="ASSET")
    parser.add_argument("--write", action="store_true")
    arguments = parser.parse_args()
    load_mitsuba()
    asset = load(arguments.asset)
    report: dict = {
        "setting": setting(luminaire=asset.luminaire),
        "thresholds": measure_thresholds(asset),
        "depths": [],
    }
    while True:
        report["depths"].append(measure_depth(asset))
        print(report["depths"][-1], flush=True)
        if asset.tree_depth == MAX_TREE_DEPTH:
            break
        asset = deepened(asset)
    print(table(report))
    if arguments.write:
        notes = "".join(f"* {key}: {value}\n" for key, value in report["setting"].items())
        write_json(RESULTS / "query.json", report)
        with atomic_path(RESULTS / "query.md") as path:
            path.write_text(f"# A query\n\n{table(report)}\n{notes}", encoding="utf-8")


if __name__ == "__main__":
    main()
