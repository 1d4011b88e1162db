"""Irradiance error of light fields against their bytes and the time of their bake.

    python -m benchmarks light_field [LUMINAIRE ...]

Writes `light_field.md` and `light_field.json`. For each luminaire and each grid:
seconds of the bake, bytes, and the error of the irradiance on the six faces of a cube around the
lamp and on a plane that touches its box, against independent light paths. The baseline is the grid
of two cells a side, whose RMS error is the unit of the last column.
"""

import argparse
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from lumitree.lamp.builtin import BUILTIN

# Depth of the grid, and bins of direction a side; the first is the baseline.
GRIDS = ((1, 64), (3, 32), (3, 64), (4, 32), (4, 64), (5, 32), (5, 64))
REFERENCE_PATHS = 1 << 22


def measure(name: str, options: argparse.Namespace) -> list[dict]:
    """A row for each grid."""
    from lumitree.asset.asset import light_field_asset
    from lumitree.fit.light_field.bake import bake_light_field
    from lumitree.lamp.luminaire import load_luminaire
    from lumitree.measure.irradiance import (
        asset_irradiance,
        irradiance_error,
        luminaire_irradiance,
    )
    from lumitree.trace.light_field_config import LightFieldConfig

    luminaire = load_luminaire(name)
    reference = luminaire_irradiance(luminaire, REFERENCE_PATHS, seed=options.seed + 1)
    rows = []
    for depth, resolution in GRIDS:
        config = LightFieldConfig(paths=options.paths, depth=depth, resolution=resolution)
        with tempfile.TemporaryDirectory() as folder:
            start = time.perf_counter()
            field = bake_light_field(luminaire, config, Path(folder), seed=options.seed)
            seconds = time.perf_counter() - start
        asset = light_field_asset(field, luminaire.frame, luminaire.name)
        error = irradiance_error(asset_irradiance(asset, REFERENCE_PATHS), reference)
        rows.append(
            {
                "luminaire": name,
                "depth": depth,
                "resolution": resolution,
                "seconds": seconds,
                "bytes": field.num_bytes,
                "cells": len(field.cells),
                "ratio": error.ratio.tolist(),
                "ratio_error": error.ratio_error.tolist(),
                "rms": error.rms.tolist(),
                "rms_error": error.rms_error.tolist(),
            }
        )
    return rows


def table(rows: list[dict]) -> Table:
    """A line for each luminaire and grid."""
    heads = ["luminaire", "cells a side", "bins a side", "bake", "size", "ratio of a face"]
    heads += ["RMS, mean", "RMS, worst face", "RMS, touching", "mean RMS / baseline"]
    lines, baseline = [], 1.0
    for row in rows:
        faces = row["rms"][:6]
        mean = sum(faces) / 6
        if (row["depth"], row["resolution"]) == GRIDS[0]:
            baseline = mean
        lines.append(
            [
                row["luminaire"],
                str(1 << row["depth"]),
                str(row["resolution"]),
                f"{row['seconds']:.1f} s",
                f"{row['bytes'] / 1e6:.2f} MB",
                f"{min(row['ratio'][:6]):.3f} to {max(row['ratio'][:6]):.3f}",
                f"{100 * mean:.1f} %",
                f"{100 * max(faces):.1f} %",
                f"{100 * row['rms'][6]:.1f} %",
                f"{mean / baseline:.2f}",
            ]
        )
    return Table(heads, lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaires", metavar="LUMINAIRE", nargs="*", default=list(BUILTIN))
    parser.add_argument(
        "--paths", type=int, metavar="N", default=1 << 22, help="light paths of a bake"
    )
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    results = Results(options, paths=options.paths, reference_paths=REFERENCE_PATHS)
    rows: list[dict] = []
    for name in options.luminaires:
        rows += measure(name, options)
        facts = results.setting()
        text = f"# Light fields\n\n{table(rows).markdown()}\n{notes(facts)}"
        results.write({"setting": facts, "rows": rows}, text)
        print(f"measured {name}", file=sys.stderr)
    print(table(rows).text())
