"""Luminaires in numbers: python benchmarks/luminaires.py LUMINAIRE...

Writes `luminaires.md` and `luminaires.json` into benchmarks/results/: triangles, emitters, L_max
(of the preview's six views), luminous flux with its standard error, capture throughput (median of 5
pictures, after one that compiles), and what paths of 32, 64 and 128 bounces miss of the light that
paths of 256 carry.
"""

import json
import statistics
import sys
import time
from pathlib import Path

from lumitree.core.backend import load_mitsuba

RESULTS = Path(__file__).parent / "results"
RESOLUTION, SAMPLES = 192, 32
ROUNDS = 5
FLUX_PATHS, BOUNCE_PATHS = 1 << 22, 1 << 21
PATH_DEPTHS = (32, 64, 128)


def measure(source: str) -> dict:
    """One row of the table."""
    from lumitree.capture.flux import estimate_flux, missed_by_depth
    from lumitree.core.images import max_radiance
    from lumitree.evaluation.preview import take_preview
    from lumitree.luminaires.luminaire import load_luminaire

    luminaire = load_luminaire(source)
    flux = estimate_flux(luminaire, FLUX_PATHS)
    missed = missed_by_depth(luminaire, BOUNCE_PATHS, PATH_DEPTHS)
    return {
        "luminaire": luminaire.name,
        "triangles": luminaire.num_triangles,
        "emitters": luminaire.num_emitters,
        "max_radiance": max_radiance([take_preview(luminaire, RESOLUTION, SAMPLES).radiance]),
        "lumens": flux.lumens,
        "lumens_error": flux.lumens_error,
        "paths_per_second": throughput(luminaire),
        "missed": {each.path_depth: (each.share, each.error) for each in missed},
    }


def throughput(luminaire) -> float:
    """Paths a second of a capture: radiance and both opacities."""
    from lumitree.capture.camera import Camera
    from lumitree.core.sampling import view_pose

    camera = Camera(luminaire, RESOLUTION, SAMPLES)
    seconds = []
    for index in range(1, ROUNDS + 2):
        start = time.perf_counter()
        camera.take(view_pose(index, 2 * luminaire.bounding_radius), index)
        seconds.append(time.perf_counter() - start)
    return RESOLUTION**2 * SAMPLES / statistics.median(seconds[1:])


def table(rows: list[dict]) -> str:
    """The rows in Markdown."""
    heads = ["luminaire", "triangles", "emitters", "L_max", "flux (lm)", "paths/s (million)"]
    heads += [f"missed at {depth}" for depth in PATH_DEPTHS]
    lines = ["| " + " | ".join(heads) + " |", "|---" + "|---:" * (len(heads) - 1) + "|"]
    for row in rows:
        cells = [
            row["luminaire"],
            f"{row['triangles']:,}",
            str(row["emitters"]),
            f"{row['max_radiance']:.3g}",
            f"{row['lumens']:.4g} ± {row['lumens_error']:.2g}",
            f"{row['paths_per_second'] / 1e6:.2f}",
            *(
                f"{100 * share:.2g} ± {100 * error:.1g} %"
                for share, error in row["missed"].values()
            ),
        ]
        lines.append("| " + " | ".join(cells) + " |")
    return "\n".join(lines) + "\n"


def main(sources: list[str]) -> None:
    mi = load_mitsuba()
    rows = []
    for source in sources:
        rows.append(measure(source))
        print(f"measured {source}", file=sys.stderr)
    setting = {
        "variant": mi.variant(),
        "mitsuba": mi.__version__,
        "resolution": RESOLUTION,
        "samples_per_pixel": SAMPLES,
        "flux_paths": FLUX_PATHS,
        "bounce_paths": BOUNCE_PATHS,
    }
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "luminaires.json").write_text(
        json.dumps({"setting": setting, "rows": rows}, indent=1)
    )
    note = ", ".join(f"{key} {value}" for key, value in setting.items())
    (RESULTS / "luminaires.md").write_text(f"{table(rows)}\n{note}; lengths taken as metres\n")
    print(table(rows))


if __name__ == "__main__":
    main(sys.argv[1:] or ["bulbs"])
