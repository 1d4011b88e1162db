"""Seconds of whole commands, beside the seconds of `bake` in the same run.

    python -m benchmarks commands [--before TREE] [--only NAME ...] [--work FOLDER]

Each command is a process: it reads a ceiling lamp of 99,376 triangles with rough glass, its asset,
or what an earlier command wrote. After a round that fills the caches of compiled kernels, commands
take turns for `--rounds` rounds; figures are medians of the processor's seconds, of all cores, and
of seconds by the wall. With `--before`, the commands of another working tree of lumitree take turns
with them. `--first` also measures a first run, with empty caches.

The room of `render` has 452,000 triangles. `extract` needs the extra `network`; its run is trained
once, and kept in `--work` with all other files.

Writes `commands.md` and `commands.json`.
"""

import argparse
import os
import shutil
import statistics
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from lumitree.errors import LumitreeError

ROOT = Path(__file__).parents[1]
BASELINE = "bake"
ROOM = "office.xml --place lamp.lumitree --at 0,2.3,-0.3 --size 0.4 --lumens 3000"
# In an order in which each finds the files of those before it.
COMMANDS = {
    "help": "--help",
    BASELINE: "bake lamp/luminaire.xml -o lamp.lumitree",
    "info": "info lamp.lumitree",
    "preview lamp": "preview lamp/luminaire.xml -o lamp.png",
    "preview asset": "preview lamp.lumitree -o asset.png",
    "view": "view lamp.lumitree -o lamp.html",
    "render, 1 sample": f"render {ROOM.replace('office', 'room')} -o room.png --spp 1",
    "photometry asset": "photometry lamp.lumitree -o lamp.ies",
    "photometry file": "photometry lamp.ies -o report.pdf",
    "illuminance": f"illuminance {ROOM} --plane 0,0.75,0 --extent 4,3 --spacing 0.25 -o plan.png",
    "evaluate": "evaluate lamp.lumitree lamp/luminaire.xml -o evaluation.png",
    "extract": "extract run -o network.lumitree",
    "demo": "demo -o demo",
}
# Run once before, for `extract`.
TRAINING = ("capture lamp/luminaire.xml -o views --views 24 --resolution 96", "train views -o run")
_VASES = 4
# As an installation has the modules: compiled.
_COMPILED = {"PYTHONDONTWRITEBYTECODE": ""}


def write_inputs(folder: Path) -> None:
    """The lamp, `lamp/luminaire.xml`; the office of the examples, and with vases `room.xml`."""
    from lumitree.asset.materials import MetallicRoughness
    from lumitree.lamp.builtin.fittings import TUNGSTEN, around, canopy, emitting
    from lumitree.lamp.materials import Material, glass
    from lumitree.lamp.meshes import lathe, sphere
    from lumitree.lamp.parts import Geometry, Part
    from lumitree.lamp.scene_writer import write_scene

    angle = np.linspace(0, np.pi / 2, 120)
    bowl = 0.2 * np.column_stack([np.sin(angle), -0.5 * np.cos(angle)])
    shade = lathe(np.concatenate([bowl, 0.98 * bowl[::-1]]), 188)
    parts = (
        Part("shade", shade, "frosted"),
        Part("plate", canopy(0.19, 0.03), "white"),
        Part("bulb", sphere(0.02, 16), "filament", tuple(around(3, 0.07, -0.035))),
    )
    frosted = Material("frosted", glass(roughness=0.5))
    white = Material("white", MetallicRoughness(base_color=(0.8, 0.8, 0.8)))
    light = emitting(TUNGSTEN, "filament", (900.0, 650.0, 400.0))
    write_scene(Geometry(parts, (frosted, white, light)), folder / "lamp")
    office = (ROOT / "examples/office.xml").read_text(encoding="utf-8")
    (folder / "office.xml").write_text(office, encoding="utf-8")
    vases = "".join(
        '<shape type="ply"><string name="filename" value="lamp/meshes/shade.ply"/><ref id="wood"/>'
        f'<transform name="to_world"><translate x="{i - 1.5}" y="0.2"/></transform></shape>'
        for i in range(_VASES)
    )
    room = office.replace("</scene>", f"{vases}</scene>")
    (folder / "room.xml").write_text(room, encoding="utf-8")


def seconds(arguments: str, folder: Path, tree: Path, **environment: str) -> dict[str, float]:
    """Seconds of a command of a working tree, of the processor (`cpu`) and by the wall (`wall`).

    Raises:
        LumitreeError: it failed.
    """
    start = time.perf_counter()
    process = subprocess.Popen(
        [sys.executable, "-m", "lumitree", *arguments.split()],
        cwd=folder,
        env=os.environ | _COMPILED | {"PYTHONPATH": str(tree / "src")} | environment,
        stdout=subprocess.DEVNULL,
        stderr=(folder / "errors.txt").open("w"),
    )
    _, status, usage = os.wait4(process.pid, 0)
    process.returncode = os.waitstatus_to_exitcode(status)
    if process.returncode:
        said = (folder / "errors.txt").read_text(errors="replace").strip().rpartition("\n")[2]
        raise LumitreeError(f"lumitree {arguments}: failed: {said}")
    wall = time.perf_counter() - start
    return {"cpu": usage.ru_utime + usage.ru_stime, "wall": wall}


def table(rows: list[dict[str, Any]]) -> Table:
    """A line for each command."""
    columns = [name for name in ("before", "now", "first") if name in rows[0]]
    heads = ["command"]
    for name in columns:
        heads += [f"{name}: CPU s", "wall s", "CPU / bake"]
    lines = []
    for row in rows:
        line = [row["command"]]
        for name in columns:
            cpu, wall = row[name]["cpu"], row[name]["wall"]
            line += [f"{cpu:.1f}", f"{wall:.1f}", f"{row[name]['over_bake']:.2f}"]
        lines.append(line)
    return Table(heads, lines)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("--before", metavar="TREE", type=Path, help="working tree to compare with")
    parser.add_argument("--only", metavar="NAME", nargs="+", choices=COMMANDS, default=[*COMMANDS])
    parser.add_argument("--first", action="store_true", help="measure a first run too")
    parser.add_argument("--work", metavar="FOLDER", type=Path, default=Path("commands.work"))
    parser.add_argument("--rounds", type=int, default=3)
    parser.add_argument("--warm", action="store_true", help="kernels are compiled: no first round")


def run(options: argparse.Namespace) -> None:
    results = Results(options, rounds=options.rounds)
    trees = {"now": ROOT} if options.before is None else {"before": options.before, "now": ROOT}
    names = [name for name in COMMANDS if name in {BASELINE, *options.only}]
    folders = {tree: (options.work / tree).resolve() for tree in trees}
    for tree, folder in folders.items():
        folder.mkdir(parents=True, exist_ok=True)
        write_inputs(folder)
        if "extract" in names and not (folder / "run/run.npz").exists():
            for arguments in TRAINING:
                seconds(arguments, folder, trees[tree])
    found: dict[str, dict[str, list[dict[str, float]]]] = {name: {} for name in names}
    for index in range(1 if options.warm else 0, options.rounds + 1):
        for name in names:
            for tree, folder in folders.items():
                taken = seconds(COMMANDS[name], folder, trees[tree].resolve())
                figures = f"{taken['cpu']:.1f} s of the processor, {taken['wall']:.1f} s"
                print(f"round {index}: {name}, {tree}: {figures}", file=sys.stderr, flush=True)
                found[name].setdefault(tree, []).extend([taken] if index else [])
    if options.first:
        for name in names:
            home = folders["now"] / "empty"
            shutil.rmtree(home, ignore_errors=True)
            home.mkdir()
            found[name]["first"] = [seconds(COMMANDS[name], folders["now"], ROOT, HOME=str(home))]
    rows: list[dict[str, Any]] = []
    for name in names:
        row: dict[str, Any] = {"command": name, "arguments": COMMANDS[name]}
        for tree, each in found[name].items():
            row[tree] = {clock: statistics.median(t[clock] for t in each) for clock in each[0]}
        rows.append(row)
    baseline = next(row for row in rows if row["command"] == BASELINE)
    for row in rows:
        for tree in found[BASELINE]:
            row[tree]["over_bake"] = row[tree]["cpu"] / baseline[tree]["cpu"]
    facts = results.setting()
    text = f"# Commands\n\n{table(rows).markdown()}\n{notes(facts)}"
    results.write({"setting": facts, "commands": rows}, text)
    print(table(rows).text(), flush=True)
