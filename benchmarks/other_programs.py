"""One exported lamp in several programs: illuminance of a plane below it.

    python -m benchmarks other_programs [--lights N ...] [--assets FOLDER] [LUMINAIRE ...]

Writes `other_programs.md` and `other_programs.json`. Each lamp is written by `lumitree.export` for
each target. Compared is direct illuminance on a grid of points of a horizontal plane, 1.5 box sizes
below the centre of the lamp and 2 box sizes wide, with that by `lumitree.illuminance` of the asset,
which sums the whole light field. "Program": the program itself opened the file and computed the
illuminance: Radiance by `rtrace`, after `ies2rad` for IES files, and Cycles by an image of a white
plane. "File": the benchmark read the written files by a reader of its own, and summed I cos θ / d²
over their lights; no program opened them. The table names programs that are not installed: Radiance
needs the extra `radiance`, USD the extra `usd`, and Cycles `--blender`, or the variable
LUMITREE_BLENDER_PYTHON, a Python with the module bpy.
"""

import argparse
import dataclasses
import os
import sys
import tempfile
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.cycles.plane import plane_lux
from benchmarks.exported_files import gltf, ies_folder, pbrt, usd
from benchmarks.exported_files.lights import ReadLight, summed_lux
from benchmarks.radiance_rooms.program import Radiance
from lumitree.errors import LumitreeError

Array = NDArray[np.float64]
# In box sizes: below the centre of the lamp, and the side of the plane.
BELOW, SIDE = 1.5, 2.0
POINTS_A_SIDE = 5
# A scene needs something; this is black and far away, in box sizes.
_SPECK = 1e3
_SEEDS = 4


@dataclasses.dataclass(frozen=True)
class Plane:
    """A horizontal plane below a lamp, in the frame of the lamp's file with y up.

    Attributes:
        centre: [3], m.
        side: m.
    """

    centre: Array
    side: float

    @property
    def points(self) -> Array:
        """[N, 3] in the middles of equal squares, by rows of z and columns of x."""
        grid = ((np.arange(POINTS_A_SIDE) + 0.5) / POINTS_A_SIDE - 0.5) * self.side
        z, x = np.meshgrid(grid, grid, indexing="ij")
        return self.centre + np.stack([x, np.zeros_like(x), z], axis=-1).reshape(-1, 3)

    @property
    def normals(self) -> Array:
        """[N, 3], up."""
        return np.tile([0.0, 1.0, 0.0], (POINTS_A_SIDE**2, 1))


def plane_below(asset: Any) -> Plane:
    """The plane of an asset."""
    size = float(asset.frame.size.max())
    return Plane(asset.frame.centre - [0, BELOW * size, 0], SIDE * size)


@dataclasses.dataclass(frozen=True)
class Found:
    """Illuminance [N], lx, its standard error [N], lx, and the program that computed it."""

    lux: Array
    error: Array
    program: str


def reference(asset: Any, plane: Plane, options: argparse.Namespace) -> Found:
    """By `lumitree.illuminance`."""
    import lumitree

    far = (plane.centre - [0, _SPECK * plane.side, 0]).tolist()
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0}}
    speck = {"type": "sphere", "radius": plane.side, "center": far, "bsdf": black}
    found = lumitree.illuminance(
        {"type": "scene", "speck": speck},
        [lumitree.Placement(asset)],
        points=plane.points,
        normals=plane.normals,
        error=options.error,
        direct=True,
        seed=options.seed,
    )
    return Found(found.direct, found.direct_error, "lumitree")


def by_radiance(path: Path, plane: Plane, options: argparse.Namespace) -> Found:
    radiance = Radiance(path.parent)
    text = f"!xform {path.name}\n"
    found = radiance.illuminance(text, plane.points, plane.normals, bounces=0, repeats=2)
    return Found(found.lux, found.error, radiance.version())


def ies_text(radiance: Radiance, folder: Path) -> str:
    """Scene of Radiance with the IES files of a folder, by `ies2rad`, each at its place."""
    return "".join(
        radiance.photometric_source(folder / row["file"], ies_folder.place(row))
        for row, _ in ies_folder.placed_profiles(folder)
    )


def by_ies2rad(path: Path, plane: Plane, options: argparse.Namespace) -> Found:
    radiance = Radiance(path.parent)
    text = ies_text(radiance, path)
    found = radiance.illuminance(text, plane.points, plane.normals, bounces=0, repeats=4)
    return Found(found.lux, found.error, radiance.version())


def by_cycles(path: Path, plane: Plane, options: argparse.Namespace) -> Found:
    from lumitree.exports.blender import find_blender

    program = find_blender(options.blender)
    seeds = [options.seed + index for index in range(_SEEDS)]
    return Found(
        *plane_lux(program, path, plane.centre, plane.side, POINTS_A_SIDE, options.spp, seeds)
    )


def by_reader(read: Callable[[Path], list[ReadLight]]) -> Callable[..., Found]:
    """Sum of the lights that a reader of the benchmark finds."""

    def lux(path: Path, plane: Plane, options: argparse.Namespace) -> Found:
        found = summed_lux(read(path), plane.points, plane.normals)
        return Found(found, np.zeros_like(found), "reader of the benchmark")

    return lux


@dataclasses.dataclass(frozen=True)
class Opened:
    """A target of `lumitree export`, and how its files are opened.

    Attributes:
        name: of the target.
        output: name of what is exported.
        how: "program" or "file".
        lux: illuminance of a file on a plane.
    """

    name: str
    output: str
    how: str
    lux: Callable[[Path, Plane, argparse.Namespace], Found]


TARGETS = (
    Opened("Radiance, .rad", "lamp.rad", "program", by_radiance),
    Opened("Blender's Cycles, .py", "lamp.py", "program", by_cycles),
    Opened("IES files, by ies2rad", "lamp", "program", by_ies2rad),
    Opened("pbrt-v4, .pbrt", "lamp.pbrt", "file", by_reader(pbrt.read_lights)),
    Opened("OpenUSD, .usda", "lamp.usda", "file", by_reader(usd.read_lights)),
    Opened("glTF, .glb", "lamp.glb", "file", by_reader(gltf.read_lights)),
    Opened("IES files", "lamp", "file", by_reader(ies_folder.read_lights)),
)


def measure(name: str, asset: Any, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of a lamp: each target with each number of lights."""
    import lumitree

    plane = plane_below(asset)
    exact = reference(asset, plane, options)
    rows = []
    for target in TARGETS:
        for lights in options.lights:
            row = {"luminaire": name, "target": target.name, "how": target.how, "lights": lights}
            with tempfile.TemporaryDirectory() as scratch:
                path = Path(scratch) / target.output
                try:
                    lumitree.export(asset, path, lights=lights)
                    found = target.lux(path, plane, options)
                except LumitreeError as error:
                    rows.append({**row, "left_out": str(error)})
                    continue
            rows.append({**row, "program": found.program, **compared(found, exact)})
    return rows


def compared(found: Found, exact: Found) -> dict[str, Any]:
    """Figures of an illuminance against the reference.

    Returns:
        `mean_lux` of the reference; `ratio` of the means; `rms`, the root mean square difference,
        and `noise`, what of it is expected of the noise of both, over the mean; `worst`, the
        relative difference of the point where it is largest; and the values.
    """
    mean = exact.lux.mean()
    relative = found.lux / exact.lux - 1
    return {
        "mean_lux": float(mean),
        "ratio": float(found.lux.mean() / mean),
        "rms": float(np.sqrt(((found.lux - exact.lux) ** 2).mean()) / mean),
        "noise": float(np.sqrt((found.error**2 + exact.error**2).mean()) / mean),
        "worst": float(relative[np.abs(relative).argmax()]),
        "lux": found.lux.tolist(),
        "lux_error": found.error.tolist(),
        "lumitree_lux": exact.lux.tolist(),
        "lumitree_lux_error": exact.error.tolist(),
    }


def table(rows: list[dict[str, Any]]) -> Table:
    """A line for each lamp, target and number of lights."""
    heads = ["luminaire", "target", "opened by", "lights", "ratio of means", "RMS / mean"]
    heads += ["noise", "worst point"]
    names = {"program": "program", "file": "benchmark's reader"}
    lines = []
    for row in rows:
        if "left_out" in row:
            figures = ["left out", "", "", ""]
        else:
            figures = [f"{row['ratio']:.3f}", f"{row['rms']:.1%}", f"{row['noise']:.1%}"]
            figures.append(f"{row['worst']:+.1%}")
        first = [row["luminaire"], row["target"], names[row["how"]], str(row["lights"])]
        lines.append([*first, *figures])
    return Table(heads, lines, left=3)


def report(rows: list[dict[str, Any]], facts: dict[str, Any]) -> str:
    """Text of the Markdown file."""
    text = (
        "# One lamp in several programs\n\n"
        f"Direct illuminance on {POINTS_A_SIDE} x {POINTS_A_SIDE} points of a horizontal plane, "
        f"{BELOW:g} box sizes below the centre of the lamp and {SIDE:g} box sizes wide, against "
        "`lumitree.illuminance` of the asset. *Program*: it opened the file and computed the "
        "illuminance. *Benchmark's reader*: a reader of the benchmark read the written files and "
        "summed I cos θ / d² over their lights; no program opened them.\n\n"
    )
    text += f"{table(rows).markdown()}\n"
    for reason in dict.fromkeys(
        f"{row['target']} is left out: {row['left_out']}" for row in rows if "left_out" in row
    ):
        text += f"* {reason}\n"
    opened = (row for row in rows if row["how"] == "program")
    programs = dict.fromkeys(row["program"] for row in opened if "program" in row)
    return text + notes({**facts, "programs": ", ".join(programs)})


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaires", metavar="LUMINAIRE", nargs="*", default=["bulbs", "dallas"])
    parser.add_argument(
        "--lights", type=int, nargs="+", metavar="N", default=[16, 64], help="of the exports"
    )
    parser.add_argument(
        "--blender",
        metavar="PROGRAM",
        default=os.environ.get("LUMITREE_BLENDER_PYTHON"),
        help="Blender, or a Python with bpy",
    )
    parser.add_argument(
        "--assets", type=Path, metavar="FOLDER", help="where assets are kept (default: nowhere)"
    )
    parser.add_argument(
        "--error", type=float, default=0.002, help="relative standard error of the reference"
    )
    parser.add_argument(
        "--spp", type=int, metavar="S", default=1 << 14, help="samples a point, of Cycles"
    )
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    import lumitree

    results = Results(options, seeds_of_cycles=_SEEDS)
    rows: list[dict[str, Any]] = []
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.assets or Path(scratch)
        for name in options.luminaires:
            path = folder / f"{name}.lumitree"
            if not path.exists():
                lumitree.bake(
                    name, path, lumitree.BakeConfig(parts=("light", "geometry"), irradiance_paths=0)
                )
            rows += measure(name, lumitree.load(path), options)
            facts = results.setting()
            results.write({"setting": facts, "rows": rows}, report(rows, facts))
            print(f"measured {name}", file=sys.stderr)
    print(table(rows).text())
