"""Luminaires in numbers: python benchmarks/luminaires.py [--data FOLDER] [LUMINAIRE ...]

Writes `luminaires.md` and `luminaires.json` into benchmarks/results/: triangles, emitters, L_max
(of the preview's six views), luminous flux with its standard error, capture throughput (median of 3
pictures, after one that compiles), and what paths of 32, 64 and 128 bounces miss of the light that
paths of 256 carry. Without a name, all built-in luminaires; `--data` adds those of a folder.
"""

import argparse
import json
import statistics
import sys
import time
from pathlib import Path

from lumitree.builtin.registry import BUILTIN
from lumitree.luminaire.source import LuminaireSource
from setting import setting

HERE = Path(__file__).parent
RESULTS, OVERRIDES = HERE / "results", HERE.parent / "examples" / "overrides"
RESOLUTION, SAMPLES = 192, 32
ROUNDS = 3
FLUX_PATHS, BOUNCE_PATHS = 1 << 20, 1 << 20
PATH_DEPTHS = (32, 64, 128)
# File, overrides, and metres in a unit of what is loaded.
DATA = (
    ("scopia_chandelier/luminaire.xml", None, 0.01),
    ("scopia_chandelier/original/chandelier-lamp.obj", "chandelier-lamp.toml", 1.0),
    ("megeon_chandelier/luminaire.xml", None, 0.01),
    ("megeon_chandelier/original/lamp2.obj", "lamp2.toml", 1.0),
    ("little_lamp/luminaire.xml", None, 0.1),
    ("barn_lamp/AnisotropyBarnLamp.gltf", None, 1.0),
    ("stained_glass_lamp/StainedGlassLamp.gltf", "stained_glass_lamp.toml", 1.0),
)


def measure(source: LuminaireSource, metres_per_unit: float) -> dict:
    """One row of the table."""
    from lumitree.core.images import max_radiance
    from lumitree.evaluation.preview import take_preview
    from lumitree.luminaire.luminaire import load_luminaire
    from lumitree.transport.flux import estimate_flux, missed_by_depth

    luminaire = load_luminaire(source)
    flux = estimate_flux(luminaire, FLUX_PATHS)
    missed = missed_by_depth(luminaire, BOUNCE_PATHS, PATH_DEPTHS)
    return {
        "luminaire": luminaire.name,
        "triangles": luminaire.num_triangles,
        "emitters": luminaire.num_emitters,
        "max_radiance": max_radiance([take_preview(luminaire, RESOLUTION, SAMPLES).radiance]),
        "metres_per_unit": metres_per_unit,
        "lumens": flux.lumens * metres_per_unit**2,
        "lumens_error": flux.lumens_error * metres_per_unit**2,
        "paths_per_second": throughput(luminaire),
        "missed": {each.path_depth: (each.share, each.error) for each in missed},
    }


def throughput(luminaire) -> float:
    """Paths a second of a capture: radiance and both opacities."""
    from lumitree.core.directions import view_pose
    from lumitree.core.seeds import Purpose, SeedStream
    from lumitree.views.camera import Camera

    camera = Camera(luminaire, RESOLUTION, SAMPLES)
    seconds = []
    for index in range(1, ROUNDS + 2):
        start = time.perf_counter()
        pose = view_pose(index, 2 * luminaire.bounding_radius)
        camera.take(pose, SeedStream(Purpose.CAPTURE, index))
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


def sources(names: list[str], data: Path | None) -> list[tuple[LuminaireSource, float]]:
    """What to measure, and the metres in a unit of each."""
    found = [(LuminaireSource(name), 1.0) for name in names]
    for file, overrides, unit in DATA if data is not None else ():
        materials = None if overrides is None else str(OVERRIDES / overrides)
        found.append((LuminaireSource(str(data / file), materials=materials), unit))
    return found


def main() -> None:
    parser = argparse.ArgumentParser(description="Luminaires in numbers.")
    parser.add_argument("luminaires", metavar="LUMINAIRE", nargs="*", default=list(BUILTIN))
    parser.add_argument("--data", metavar="FOLDER", type=Path)
    args = parser.parse_args()
    # The folder is the machine's own business.
    command = "benchmarks/luminaires.py" + " --data FOLDER" * (args.data is not None)
    facts = setting(
        command=command,
        resolution=RESOLUTION,
        samples_per_pixel=SAMPLES,
        flux_paths=FLUX_PATHS,
        bounce_paths=BOUNCE_PATHS,
    )
    rows = []
    for source, unit in sources(args.luminaires, args.data):
        rows.append(measure(source, unit))
        write(rows, facts)
        print(f"measured {source}", file=sys.stderr)


def write(rows: list[dict], facts: dict) -> None:
    """Both files, after every row: the slowest luminaire takes minutes."""
    RESULTS.mkdir(exist_ok=True)
    (RESULTS / "luminaires.json").write_text(
        json.dumps({"setting": facts, "rows": rows}, indent=1) + "\n"
    )
    note = "\n".join(f"* {key}: {value}" for key, value in facts.items())
    (RESULTS / "luminaires.md").write_text(f"# Luminaires in numbers\n\n{table(rows)}\n{note}\n")


if __name__ == "__main__":
    main()
