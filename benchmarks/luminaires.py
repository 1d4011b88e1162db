"""Figures of luminaires, and the time of a capture against that of a plain emissive cube.

    python -m benchmarks luminaires [--data FOLDER] [LUMINAIRE ...]

Writes `luminaires.md` and `luminaires.json`: triangles, emitters, L_max (of the preview's six
views), luminous flux with its standard error, and what paths of 32, 64 and 128 bounces miss of the
light that paths of 256 carry. Capture throughput is timed in turns with a plain emissive cube, the
baseline, under the same camera. Without a name, all built-in luminaires; `--data` adds those of a
folder.
"""

import argparse
import functools
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.common.lamps import add_luminaires, sources
from benchmarks.common.options import add_pixels, add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import Job, interleaved, ratios
from lumitree.lamp.source import LuminaireSource

PATHS = 1 << 20  # of the flux, and of what short paths miss
BASELINE = "plain cube"
PLAIN_CUBE = (
    '<scene version="3.0.0"><shape type="cube"><emitter type="area">'
    '<rgb name="radiance" value="1"/></emitter></shape></scene>'
)
PATH_DEPTHS = (32, 64, 128)


def measure(
    source: LuminaireSource, metres_per_unit: float, baseline: Job, options: argparse.Namespace
) -> dict:
    """One row of the table.

    Args:
        baseline: capture of the plain cube.
    """
    from lumitree.core.images import max_radiance
    from lumitree.lamp.loading import load_luminaire
    from lumitree.output.preview_sheet import take_preview
    from lumitree.trace.flux import estimate_flux, missed_by_depth

    luminaire = load_luminaire(source)
    flux = estimate_flux(luminaire, PATHS, seed=options.seed)
    missed = missed_by_depth(luminaire, PATHS, PATH_DEPTHS, seed=options.seed)
    preview = take_preview(luminaire, options.resolution, options.spp)
    times = interleaved({BASELINE: baseline, "capture": capture(luminaire, options)})
    return {
        "luminaire": luminaire.name,
        "triangles": luminaire.num_triangles,
        "emitters": luminaire.num_emitters,
        "max_radiance": max_radiance([preview.radiance]),
        "metres_per_unit": metres_per_unit,
        "lumens": flux.lumens * metres_per_unit**2,
        "lumens_error": flux.lumens_error * metres_per_unit**2,
        "paths_per_second": options.resolution**2 * options.spp / times["capture"],
        "time_over_plain_cube": ratios(times, BASELINE)["capture"],
        "missed": {each.path_depth: (each.share, each.error) for each in missed},
    }


def capture(luminaire: Any, options: argparse.Namespace) -> Job:
    """Job: a view of a capture, with its radiance and both opacities."""
    from lumitree.core.directions import view_pose
    from lumitree.core.seeds import Purpose, SeedStream
    from lumitree.trace.cameras import Camera

    camera = Camera(luminaire, options.resolution, options.spp)

    def view(index: int) -> Any:
        pose = view_pose(index + 1, 2 * luminaire.bounding_radius)
        return functools.partial(camera.take, pose, SeedStream(Purpose.CAPTURE, index + 1))

    return view


def plain_cube(options: argparse.Namespace) -> Job:
    """The same of a cube that emits the same radiance everywhere."""
    from lumitree.lamp.loading import load_luminaire

    with tempfile.TemporaryDirectory() as folder:
        file = Path(folder) / "plain_cube.xml"
        file.write_text(PLAIN_CUBE)
        return capture(load_luminaire(str(file)), options)


def table(rows: list[dict]) -> Table:
    """A line for each luminaire."""
    heads = ["luminaire", "triangles", "emitters", "L_max", "flux (lm)", "paths/s (million)"]
    heads += ["time / plain cube", *(f"missed at {depth}" for depth in PATH_DEPTHS)]
    lines = [
        [
            row["luminaire"],
            f"{row['triangles']:,}",
            str(row["emitters"]),
            f"{row['max_radiance']:.3g}",
            f"{row['lumens']:.4g} ± {row['lumens_error']:.2g}",
            f"{row['paths_per_second'] / 1e6:.2f}",
            f"{row['time_over_plain_cube']:.1f}",
            *(
                f"{100 * share:.2g} ± {100 * error:.1g} %"
                for share, error in row["missed"].values()
            ),
        ]
        for row in rows
    ]
    return Table(heads, lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    add_luminaires(parser)
    add_pixels(parser, "--resolution", 192, 32)
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    results = Results(
        options,
        resolution=options.resolution,
        samples_per_pixel=options.spp,
        flux_paths=PATHS,
        bounce_paths=PATHS,
        baseline=BASELINE,
    )
    baseline, rows = plain_cube(options), []
    for source, unit in sources(options.luminaires, options.data):
        rows.append(measure(source, unit, baseline, options))
        # After every row: the slowest luminaire takes minutes.
        facts = results.setting()
        text = f"# Luminaires in numbers\n\n{table(rows).markdown()}\n{notes(facts)}"
        results.write({"setting": facts, "rows": rows}, text)
        print(f"measured {source}", file=sys.stderr)
    print(table(rows).text())
