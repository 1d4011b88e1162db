"""Representations of a luminaire's light against each other: error, bytes, time and variance.

    python -m benchmarks representations [LUMINAIRE ...]

All are fitted to the same light paths, but for lumitree's field, whose octree fit traces rays of
its own. For each: seconds of the fit, bytes, the RMS error of the irradiance on the faces of a cube
around the lamp and on a plane that touches its box against other light paths; the
gain over black of images from outside, against captured views; nanoseconds of a query of radiance
along a line, and of a direction sampled towards the lamp with what arrives from there; and the
variance of the irradiance that one such sample estimates, over the square of its mean. The
baseline of times and variances is the light field at its defaults. Writes
`representations.md`, `representations.json` and `representations.png`.
"""

import argparse
import sys
import tempfile
import time
from collections.abc import Callable, Mapping
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import Job, interleaved, kernel
from lumitree.core.extras import check_network
from lumitree.lamp.builtin.registry import BUILTIN

REFERENCE_PATHS = 1 << 22
BASELINE, FIELD = "light field 32³ x 32²", "field, octree fit"
# Receivers, local units; each faces the lamp's centre.
RECEIVERS = {"below": (0.0, -6.0, 0.0), "beside": (4.0, 0.0, 0.5), "near": (0.3, -1.4, 0.2)}
SAMPLES = 1 << 18
# So many that the time for recording a kernel does not count: networks are evaluated outside of it.
QUERIES = 1 << 20
# Metrics of images from outside, and digits.
IMAGES = {"gain_linear": 1, "gain_mulaw": 1, "ssim_linear": 3}
# By a word of a representation's name, what the plot calls it.
FAMILIES = {
    "far field, point": "far field (IES), point",
    "far field, sphere": "far field (IES), sphere",
    "ray set": "ray set",
    "point lights": "anisotropic point lights (Velázquez-Armendáriz)",
    "table": "table on the box",
    "harmonics": "harmonics on the box",
    "wavelets": "wavelets on the box (Atanasov & Koylazov)",
    "flow": "normalizing flow (PureLight)",
    "light field": "light field",
    FIELD: "field (octree fit)",
}


def fits(name: str, options: argparse.Namespace) -> Mapping[str, Callable[[Any], Any]]:
    """What is compared, by name; each takes the traced rays of a luminaire."""
    from benchmarks.baselines.fitting import (
        RaySet,
        baked_field,
        box_harmonics,
        box_table,
        far_field_point,
        far_field_sphere,
        light_field,
        point_lights,
        wavelet_light,
    )
    from benchmarks.baselines.light_flow import LightFlow

    seed = options.seed
    chosen: dict[str, Callable[[Any], Any]] = {
        "far field, point": far_field_point,
        "far field, sphere": far_field_sphere,
        "ray set": lambda rays: RaySet(rays, options.set_rays, seed),
        "normalizing flow": lambda rays: LightFlow(rays, seed),
    }
    for count in (16, 128, 1024):
        chosen[f"{count} point lights x 32²"] = lambda rays, count=count: point_lights(
            rays, count, 32, seed
        )
    for patches, resolution in ((8, 16), (16, 16), (16, 32)):
        chosen[f"box table {patches}² x {resolution}²"] = (
            lambda rays, patches=patches, resolution=resolution: box_table(
                rays, patches, resolution
            )
        )
    for patches, l_max in ((16, 2), (16, 4), (64, 4)):
        chosen[f"box {patches}², harmonics to {l_max}"] = (
            lambda rays, patches=patches, l_max=l_max: box_harmonics(rays, patches, l_max)
        )
    for positions, megabytes in ((16, 0.1), (16, 0.4), (16, 1.6), (32, 1.6)):
        chosen[f"wavelets {positions}² x 32², {megabytes} MB"] = (
            lambda rays, positions=positions, megabytes=megabytes: wavelet_light(
                rays, positions, 32, megabytes * 1e6
            )
        )
    for depth, resolution in ((3, 32), (4, 32), (5, 32)):
        chosen[f"light field {1 << depth}³ x {resolution}²"] = (
            lambda rays, depth=depth, resolution=resolution: light_field(rays, depth, resolution)
        )
    chosen[FIELD] = lambda _: baked_field(name, seed)
    return chosen


def measure(name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """A row for each representation of a luminaire."""
    import lumitree
    from lumitree.core.dataset import Dataset
    from lumitree.lamp.loading import load_luminaire

    luminaire = load_luminaire(name)
    with tempfile.TemporaryDirectory() as folder:
        lumitree.capture(
            name,
            Path(folder) / "views",
            num_views=options.views,
            resolution=options.resolution,
            samples_per_pixel=options.spp,
            split="test",
            progress=None,
        )
        return _rows(name, luminaire, Dataset.open(Path(folder) / "views"), options)


def _rows(
    name: str, luminaire: Any, views: Any, options: argparse.Namespace
) -> list[dict[str, Any]]:
    from benchmarks.baselines.traced_rays import trace_rays
    from lumitree.measure.irradiance import (
        irradiance_error,
        luminaire_irradiance,
        rays_irradiance,
    )

    reference = luminaire_irradiance(luminaire, options.reference, seed=options.seed + 1)
    start = time.perf_counter()
    rays = trace_rays(luminaire, options.paths, options.seed)
    tracing = time.perf_counter() - start
    rows, queries, samples = [], {}, {}
    for label, fit in fits(name, options).items():
        start = time.perf_counter()
        made = fit(rays)
        seconds = time.perf_counter() - start
        estimate = rays_irradiance(made, rays.half_extents, options.reference)
        error = irradiance_error(estimate, reference)
        row = {
            "luminaire": name,
            "representation": label,
            "seconds": seconds + (0 if label == FIELD else tracing),
            "bytes": made.num_bytes,
            "ratio": _known(error.ratio),
            "rms": _known(error.rms),
            "mean_rms": error.mean_rms,
            "rms_error": _known(error.rms_error),
        }
        if (seen := _see(made, views, options.seed)) is not None:
            row["images"], queries[label] = seen
        if (received := _receive(made, options.seed)) is not None:
            row["variance"], samples[label] = received
        rows.append(row)
        print(f"{name}, {label}: {seconds:.0f} s", file=sys.stderr)
    times = interleaved(queries, clock="cpu"), interleaved(samples, clock="cpu")
    for row in rows:
        label = row["representation"]
        if label in queries:
            row["nanoseconds_query"] = times[0][label] / QUERIES * 1e9
        if label in samples:
            row["nanoseconds"] = times[1][label] / SAMPLES * 1e9
    return rows


def _known(values: NDArray[np.float64]) -> list[float | None]:
    """None for what is NaN: faces that no light reaches."""
    return [float(value) if np.isfinite(value) else None for value in values]


def _percent(value: float | None) -> str:
    return "none" if value is None else f"{100 * value:.1f} %"


def _see(made: Any, views: Any, seed: int) -> tuple[dict[str, float], Job] | None:
    """Metrics of images from outside, and a job that takes radiance along lines.

    None for a representation that no line sees.
    """
    import drjit as dr
    import mitsuba as mi

    from lumitree.measure.view_errors import compare_views
    from lumitree.rendering.asset_views import image_of

    manifest = views.manifest
    corner = float(np.linalg.norm(manifest.local_frame.half_extents))
    sampler = mi.load_dict({"type": "independent"})
    sampler.seed(seed, QUERIES)
    towards = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    disk = corner * mi.warp.square_to_uniform_disk_concentric(sampler.next_2d())
    origin = mi.Point3f(mi.Frame3f(towards).to_world(mi.Vector3f(disk.x, disk.y, -2 * corner)))
    dr.eval(origin, towards)
    if made.eval(origin, -towards) is None:
        return None

    def seen(origin: Any, towards: Any) -> tuple[Any, Any]:
        radiance = made.eval(origin, -towards)
        return radiance, dr.ones(mi.Float, dr.width(radiance))

    def image(frame: Any) -> Any:
        return image_of(seen, frame.pose, manifest.half_width, manifest.resolution)

    def query() -> None:
        dr.eval(made.eval(origin, -towards))
        dr.sync_thread()

    metrics = compare_views(image, views).metrics
    return {each: metrics[each] for each in IMAGES}, lambda _: query


def _receive(made: Any, seed: int) -> tuple[dict[str, float], Job] | None:
    """Variance over squared mean of one sample at each receiver, and a job that takes samples.

    None for a representation that samples no directions.
    """
    import drjit as dr
    import mitsuba as mi

    from lumitree.core.photometry import luminance

    def received(place: tuple[float, ...]) -> Any:
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed, SAMPLES)
        x = mi.Point3f(*(dr.opaque(mi.Float, value) for value in place))
        sample = made.sample_direction(x, sampler)
        if sample is None:
            return None
        direction, value = sample
        cosine = dr.maximum(dr.dot(direction, -dr.normalize(mi.Vector3f(x))), 0)
        return value * cosine

    variance = {}
    for name, place in RECEIVERS.items():
        value = received(place)
        if value is None:
            return None
        light = luminance(np.array(value, np.float64).T)
        variance[name] = float(light.var() / light.mean() ** 2)
    return variance, kernel(lambda: received(RECEIVERS["below"]))


def table(rows: list[dict[str, Any]]) -> Table:
    """A line for each luminaire and representation."""
    heads = ["luminaire", "representation", "fit", "size", "RMS, cube", "worst face", "touching"]
    heads += [*IMAGES, "ns a query", "ns a sample"]
    heads += [*(f"variance, {name}" for name in RECEIVERS), "time x variance"]
    lines, baseline = [], {}
    for row in rows:
        if row["representation"] == BASELINE:
            baseline[row["luminaire"]] = _cost(row)
    for row in rows:
        line = [
            row["luminaire"],
            row["representation"],
            f"{row['seconds']:.1f} s",
            f"{row['bytes'] / 1e6:.2f} MB",
            _percent(row["mean_rms"]),
            _percent(max(value for value in row["rms"][:6] if value is not None)),
            _percent(row["rms"][6]),
        ]
        if "images" in row:
            line += [f"{row['images'][each]:.{digits}f}" for each, digits in IMAGES.items()]
            line += [f"{row['nanoseconds_query']:.0f}"]
        else:
            line += ["none"] * (len(IMAGES) + 1)
        if "variance" in row:
            line += [f"{row['nanoseconds']:.0f}"]
            line += [f"{row['variance'][name]:.2f}" for name in RECEIVERS]
            line += [f"{_cost(row) / baseline[row['luminaire']]:.2f}"]
        else:
            line += ["none"] * (len(RECEIVERS) + 2)
        lines.append(line)
    return Table(heads, lines, left=2)


def _cost(row: dict[str, Any]) -> float:
    """Time of a sample times the geometric mean of its variances."""
    variances = [max(row["variance"][name], 1e-3) for name in RECEIVERS]
    return row["nanoseconds"] * float(np.exp(np.mean(np.log(variances))))


def draw(rows: list[dict[str, Any]], path: Path) -> None:
    """Irradiance error against bytes and against the time of a sample, by luminaire."""
    import matplotlib

    matplotlib.use("agg")
    from matplotlib import pyplot as plt
    from matplotlib.ticker import FuncFormatter, LogLocator, NullFormatter

    names = list(dict.fromkeys(row["luminaire"] for row in rows))
    figure, panels = plt.subplots(
        2,
        len(names),
        figsize=(4 * len(names), 7),
        sharex="row",
        sharey=True,
        squeeze=False,
        layout="constrained",
    )
    columns = {"bytes": (1e-6, "MB"), "nanoseconds": (1, "CPU time of a sample, ns")}
    for line, (key, (scale, title)) in zip(panels, columns.items(), strict=True):
        for panel, name in zip(line, names, strict=True):
            for word, label in FAMILIES.items():
                found = [
                    (row[key] * scale, 100 * row["mean_rms"])
                    for row in rows
                    if row["luminaire"] == name and word in row["representation"] and key in row
                ]
                # Those without points too, so that all panels have the same colours.
                panel.plot(*np.reshape(found, (-1, 2)).T, "o-", markersize=4, label=label)
            panel.set(xscale="log", yscale="log", xlabel=title)
            panel.yaxis.set_major_locator(LogLocator(subs=(1, 2, 5)))
            panel.yaxis.set_major_formatter(FuncFormatter(lambda value, _: f"{value:g}"))
            panel.yaxis.set_minor_formatter(NullFormatter())
            panel.grid(alpha=0.3)
        line[0].set_ylabel("RMS error of the irradiance, %")
    for panel, name in zip(panels[0], names, strict=True):
        panel.set_title(name)
    handles, labels = panels[0][0].get_legend_handles_labels()
    figure.legend(handles, labels, loc="outside lower center", ncols=min(3, len(names)))
    figure.savefig(path, dpi=120)
    plt.close(figure)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaires", metavar="LUMINAIRE", nargs="*", default=list(BUILTIN))
    parser.add_argument("--paths", type=int, metavar="N", default=1 << 22, help="that are fitted")
    parser.add_argument(
        "--reference", type=int, metavar="N", default=REFERENCE_PATHS, help="paths of the reference"
    )
    parser.add_argument(
        "--set-rays", type=int, metavar="N", default=10_000_000, help="rays of the ray set"
    )
    parser.add_argument("--views", type=int, metavar="N", default=6, help="from outside")
    parser.add_argument("--resolution", type=int, metavar="R", default=192, help="pixels a side")
    parser.add_argument("--spp", type=int, metavar="S", default=512, help="samples a pixel")
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    check_network()
    results = Results(
        options,
        paths=options.paths,
        reference_paths=options.reference,
        set_rays=options.set_rays,
        views=f"{options.views} of {options.resolution}², {options.spp} samples a pixel",
        baseline=BASELINE,
    )
    rows: list[dict[str, Any]] = []
    for name in options.luminaires:
        rows += measure(name, options)
        facts = results.setting()
        text = "# Representations of a luminaire's light\n\n![Error against size]"
        text += f"(representations.png)\n\n{table(rows).markdown()}\n{notes(facts)}"
        results.write({"setting": facts, "rows": rows}, text)
        print(f"measured {name}", file=sys.stderr)
    draw(rows, results.folder / "representations.png")
    print(table(rows).text())
