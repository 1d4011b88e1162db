"""Time and memory of a scene with many lamps.

    python -m benchmarks placements ASSET [--counts 20 200 1000] [--lamps 30]

`lumitree.render` of an empty room, one sample a pixel, with a number of placements of one asset,
and with as many different assets: copies of it, which share nothing. Each is a process of its own,
so that its peak memory is its own; its CPU time includes that of starting. The baseline is one
placement. Writes `placements.md` and `placements.json`.
"""

import argparse
import json
import math
import resource
import subprocess
import sys
import tempfile
from pathlib import Path

from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from lumitree.asset.file import load

# The room's side, scene units; lamps stand in a grid and fill half of each cell.
SIDE = 10.0
ROOM = """<scene version="3.0.0"><integrator type="path"/><sensor type="perspective">
<transform name="to_world"><lookat origin="0,0,25" target="0,0,0" up="0,1,0"/></transform>
<film type="hdrfilm"><integer name="width" value="64"/><integer name="height" value="64"/></film>
</sensor><shape type="rectangle"><transform name="to_world"><scale value="10"/>
<translate z="-6"/></transform></shape></scene>
"""


def measure(folder: Path, assets: list[Path], count: int, variant: str | None) -> dict:
    """Seconds of loading and of the image, and the peak memory of the process."""
    side = math.ceil(count ** (1 / 3))
    step = SIDE / side
    lamps = []
    for index in range(count):
        cell = (index % side, index // side % side, index // side**2)
        at = [step * (each + 0.5) - SIDE / 2 for each in cell]
        name = assets[index % len(assets)].name
        lamps.append(f'[lamps.n{index}]\nasset = "{name}"\nat = {at}\nsize = {step / 2}\n')
    (folder / "lamps.toml").write_text("".join(lamps))
    (folder / "room.xml").write_text(ROOM)
    command = [
        sys.executable,
        "-m",
        "lumitree",
        "render",
        "room.xml",
        "--placements",
        "lamps.toml",
    ]
    command += ["-o", "image.exr", "--spp", "1", "--json", "result.json"]
    command += [] if variant is None else ["--variant", variant]
    before = _processor_seconds()
    subprocess.run(command, cwd=folder, check=True, capture_output=True)
    processor = _processor_seconds() - before
    result = json.loads((folder / "result.json").read_text())
    return {
        "lamps": min(len(assets), count),
        "placements": count,
        "load_seconds": result["seconds"]["load"],
        "render_seconds": result["seconds"]["render"],
        "processor_seconds": processor,
        "peak_bytes": result["peak_memory_bytes"],
    }


def _processor_seconds() -> float:
    """Time of the processor that child processes have taken so far, s."""
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def table(rows: list[dict]) -> Table:
    """A line for each number of placements."""
    heads = [
        "lamps",
        "placements",
        "load, s",
        "image, s",
        "CPU, s",
        "peak memory, MB",
        "load / one",
    ]
    lines = [
        [
            f"{row['lamps']:,}",
            f"{row['placements']:,}",
            f"{row['load_seconds']:.2f}",
            f"{row['render_seconds']:.2f}",
            f"{row['processor_seconds']:.1f}",
            f"{row['peak_bytes'] / 1e6:.0f}",
            f"{row['load_seconds'] / rows[0]['load_seconds']:.1f}",
        ]
        for row in rows
    ]
    return Table(heads, lines, left=0)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("asset", metavar="ASSET")
    parser.add_argument(
        "--counts", type=int, nargs="+", metavar="N", default=[20, 200, 1000], help="of placements"
    )
    parser.add_argument("--lamps", type=int, metavar="N", default=30, help="different lamps")


def run(options: argparse.Namespace) -> None:
    asset = load(options.asset)
    results = Results(
        options, luminaire=asset.luminaire, geometry_triangles=asset.info.geometry_triangles
    )
    content = Path(options.asset).read_bytes()
    rows = []
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        copies = [folder / f"lamp{index}.lumitree" for index in range(options.lamps)]
        for copy in copies:
            copy.write_bytes(content)
        cases = [(1, count) for count in (1, *options.counts)] + [(options.lamps, options.lamps)]
        for lamps, count in cases:
            rows.append(measure(folder, copies[:lamps], count, options.variant))
            print(f"measured {count} placements, lamps: {lamps}", file=sys.stderr)
    print(table(rows).text())
    facts = results.setting()
    results.write(
        {"setting": facts, "placements": rows},
        f"# Many lamps in a scene\n\n{table(rows).markdown()}\n{notes(facts)}",
    )
