"""Time to a finished image: rooms at night, denoised, baked against explicit and the best rival.

    python -m benchmarks finished --rooms FOLDER --data FOLDER [--work FOLDER] [SCENE ...]

Six rooms at night, each lit by one lamp alone and seen from where a person stands. An image is
finished when a reader cannot tell it from its converged, denoised reference: when the `hdr_flip` of
the displayed images, exposed alike and clipped, is at most 0.05. The reference is the baked lamp
with `--reference` samples and another seed, so the error of the bake itself does not count
(`illumination` and `rivals` measure it); `rivals` states the brightness of the other methods too.

Methods: the baked lamp with its geometry, and the explicit lamp, both by `lumitree_path`; the
explicit lamp by Mitsuba's `path`, or `volpath` where it has media; and the best rival, a light
tracer, with the path tracer where it sees nothing. All are denoised by Open Image Denoise (extra
`denoise`). Samples are doubled until an image is finished, or costs more than `--seconds`. The time
is CPU seconds of a whole command: of a process that loads the scene, renders, filters and ends
(on a GPU seconds by the wall). Kernels are compiled by a command before it. The bake is stated
apart.

Images are kept in `--work`: the same command goes on where it stopped. Writes `finished.md`,
`finished.json` and, for each scene, `finished-SCENE.png`: each method's image after about the time
in which the baked one is finished. The baseline is the baked lamp.
"""

import argparse
import dataclasses
import json
import os
import subprocess
import sys
import time
from pathlib import Path
from typing import Any, NamedTuple, get_args

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.lamps import OVERRIDES
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.equal_error.batches import code_digest, digest
from benchmarks.equal_error.errors import time_to_reach
from benchmarks.equal_error.pairs import Place, make_pair
from benchmarks.rival_methods.whole_command import Job, MethodName
from lumitree.core.backend import GPU_VARIANT, load_mitsuba
from lumitree.core.files import write_json
from lumitree.errors import LumitreeError
from lumitree.lamp.source import LuminaireSource

ROOT = Path(__file__).parents[1]
METHODS: tuple[MethodName, ...] = get_args(MethodName)
BASELINE: MethodName = "baked"
GOAL = 0.05
PATH_DEPTH = 32
# Seeds of the reference and of the images.
_REFERENCE_SEED, _SEED = 1, 0


class Eye(NamedTuple):
    """A person's view of a room: eye and target, scene units, and horizontal field of view."""

    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float


class Scene(NamedTuple):
    """A lamp in a room; `lamp` is built-in, or a file below `--data`, with its overrides."""

    lamp: str
    room: str
    place: Place
    materials: str | None = None


EYES = {
    "living_room": Eye((4.6, 1.6, -0.6), (1.2, 1.35, -2.1), 75.0),
    "veach_bidir": Eye((3.6, 4.85, 2.6), (-1.6, 3.9, -1.6), 80.0),
    "modern_hall": Eye((6.9, 1.65, 2.55), (1.5, 2.1, 0.9), 65.0),
}
SCENES = {
    "living-hanging": Scene("portica", "living_room", "hanging"),
    "living-standing": Scene("little_lamp/luminaire.xml", "living_room", "standing"),
    "veach-hanging": Scene("dallas", "veach_bidir", "hanging"),
    "veach-standing": Scene(
        "stained_glass_lamp/StainedGlassLamp.gltf",
        "veach_bidir",
        "standing",
        "stained_glass_lamp.toml",
    ),
    "hall-hanging": Scene("megeon_chandelier/luminaire_bulb.xml", "modern_hall", "hanging"),
    "hall-standing": Scene("arc", "modern_hall", "standing"),
}


def measure(name: str, options: argparse.Namespace) -> dict[str, Any]:
    """A scene's points by method, and when each is finished."""
    import lumitree

    scene, folder = SCENES[name], options.work / name
    folder.mkdir(parents=True, exist_ok=True)
    lamp = str(options.data / scene.lamp) if "/" in scene.lamp else scene.lamp
    materials = None if scene.materials is None else str(OVERRIDES / scene.materials)
    luminaire, asset = LuminaireSource(lamp, materials), folder / "lamp.lumitree"
    if not asset.exists():
        start = time.process_time()
        config = lumitree.BakeConfig(parts=("light", "geometry"), irradiance_paths=0)
        lumitree.bake(luminaire, asset, config)
        write_json(folder / "bake.json", time.process_time() - start)
    pair = make_pair(luminaire, asset, options.rooms, scene.room, scene.place)
    baked = Job(
        method=BASELINE,
        room=pair.room,
        **EYES[scene.room]._asdict(),
        lamp=pair.asset,
        materials=None,
        at=pair.at,
        size=pair.size,
        width=options.width,
        path_depth=PATH_DEPTH,
        samples=options.reference,
        seed=_REFERENCE_SEED,
        variant=load_mitsuba().variant() or "",
        output="",
    )
    explicit = dataclasses.replace(baked, lamp=lamp, materials=materials)
    reference, _ = taken(baked, folder)
    row: dict[str, Any] = {"scene": name, "lamp": scene.lamp, "methods": {}}
    row["bake_seconds"] = json.loads((folder / "bake.json").read_text())
    images = {}
    for method in METHODS:
        points, samples = [], 1
        job = dataclasses.replace(baked if method == BASELINE else explicit, method=method)
        # Kernels are compiled, and files read, by a command that does not count.
        taken(dataclasses.replace(job, samples=1), folder)
        while True:
            one = dataclasses.replace(job, samples=samples, seed=_SEED)
            image, seconds = taken(one, folder)
            error = displayed_error(image, reference)
            points.append({"samples": samples, "seconds": seconds, "hdr_flip": error})
            images[method, samples] = image
            print(f"{name}: {method}, {samples}: {seconds:.1f} s, {error:.3f}", file=sys.stderr)
            if error <= GOAL or seconds > options.seconds:
                break
            samples *= 2
        row["methods"][method] = {"points": points, **finished(points)}
    draw(options.output / f"finished-{name}.png", row["methods"], images, reference)
    return row


def taken(job: Job, folder: Path) -> tuple[NDArray[np.float32], float]:
    """The image of a job and the seconds of its process; kept in the folder from then on.

    Raises:
        LumitreeError: the process failed.
    """
    files = [Path(job.room), *([Path(job.lamp)] if job.method == "baked" else [])]
    key = digest(dataclasses.asdict(job), code_digest(), *files)
    output = folder / f"{job.method}-{job.samples}-{key}.npy"
    described, cost = output.with_suffix(".job.json"), output.with_suffix(".cost.json")
    if not cost.exists():
        write_json(described, dataclasses.asdict(dataclasses.replace(job, output=str(output))))
        command = [sys.executable, "-m", "benchmarks.rival_methods.whole_command", str(described)]
        start = time.perf_counter()
        process = subprocess.Popen(
            command, cwd=ROOT, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE
        )
        assert process.stderr is not None
        said = process.stderr.read().decode(errors="replace")
        _, status, usage = os.wait4(process.pid, 0)
        process.returncode = os.waitstatus_to_exitcode(status)
        if process.returncode:
            last = said.strip().rpartition("\n")[2]
            raise LumitreeError(f"{job.method}, {job.samples} samples: failed: {last}")
        wall, cpu = time.perf_counter() - start, usage.ru_utime + usage.ru_stime
        write_json(cost, wall if job.variant == GPU_VARIANT else cpu)
    return np.load(output), json.loads(cost.read_text())


def displayed_error(image: NDArray[np.floating], reference: NDArray[np.floating]) -> float:
    """`hdr_flip` of images [H, W, 3] exposed by the reference, and clipped as a display does."""
    from lumitree.measure.metrics import hdr_flip
    from lumitree.rendering.photograph import automatic_ev, white_radiance

    white = white_radiance(automatic_ev(reference))
    shown, goal = (np.clip(each / white, 0, 1) for each in (image, reference))
    return hdr_flip(shown, goal, 1.0)


def finished(points: list[dict[str, float]]) -> dict[str, Any]:
    """Seconds after which the error stays at or below the goal, interpolated; else the last ones.

    Returns:
        `seconds`, and `reached`, whether an image is finished.
    """
    seconds, errors = (np.array([each[key] for each in points]) for key in ("seconds", "hdr_flip"))
    if errors[-1] > GOAL:
        return {"seconds": float(seconds[-1]), "reached": False}
    return {"seconds": time_to_reach(GOAL, seconds, errors)[0], "reached": True}


def draw(
    path: Path,
    methods: dict[str, Any],
    images: dict[tuple[MethodName, int], NDArray[np.float32]],
    reference: NDArray[np.float32],
) -> None:
    """Each method's image after about the baked one's time, beside the reference."""
    from lumitree.rendering.drawing import Panel, write_strip
    from lumitree.rendering.photograph import PhotoSettings

    end, panels = methods[BASELINE]["seconds"], []
    for method in METHODS:
        point = min(methods[method]["points"], key=lambda each: abs(np.log(each["seconds"] / end)))
        caption = f"{method}, {point['samples']} samples\n{point['seconds']:.0f} s, "
        panels.append(
            Panel(f"{caption}hdr_flip {point['hdr_flip']:.3f}", images[method, point["samples"]])
        )
    path.parent.mkdir(parents=True, exist_ok=True)
    write_strip(path, [*panels, Panel("reference", reference)], PhotoSettings(), columns=3)


def times_table(rows: list[dict[str, Any]]) -> Table:
    """A line for each scene: seconds to a finished image, and over the baked lamp's."""
    heads = ["scene", "lamp", "bake, s"]
    heads += [f"{each}, s" for each in METHODS] + [f"{each} / baked" for each in METHODS[1:]]
    lines = []
    for row in rows:
        found = [row["methods"][each] for each in METHODS]
        cells = [f"{'' if each['reached'] else '> '}{each['seconds']:.1f}" for each in found]
        base = found[0]
        for each in found[1:]:
            sign = {(True, True): "", (True, False): "> "}.get((base["reached"], each["reached"]))
            ratio = each["seconds"] / base["seconds"]
            cells.append("-" if sign is None else f"{sign}{ratio:.1f}")
        lines.append([row["scene"], row["lamp"], f"{row['bake_seconds']:.0f}", *cells])
    return Table(heads, lines, left=2)


def points_table(rows: list[dict[str, Any]]) -> Table:
    """A line for each scene and method: seconds and error by samples."""
    counts = sorted(
        {p["samples"] for row in rows for m in row["methods"].values() for p in m["points"]}
    )
    lines = []
    for row in rows:
        for method, found in row["methods"].items():
            by = {
                p["samples"]: f"{p['seconds']:.1f} s, {p['hdr_flip']:.3f}" for p in found["points"]
            }
            lines.append([row["scene"], method, *(by.get(count, "") for count in counts)])
    return Table(["scene", "method", *map(str, counts)], lines, left=2)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("scenes", metavar="SCENE", nargs="*", help=f"of {', '.join(SCENES)}")
    parser.add_argument(
        "--rooms", metavar="FOLDER", type=Path, default=Path("rooms"), help="ROOM/room_night.xml"
    )
    parser.add_argument("--data", metavar="FOLDER", type=Path, default=Path("luminaires"))
    parser.add_argument("--work", metavar="FOLDER", type=Path, default=Path("finished.work"))
    parser.add_argument("--seconds", type=float, default=300.0, help="of the longest image")
    parser.add_argument("--reference", type=int, default=2048, help="samples of the reference")
    parser.add_argument("--width", type=int, default=320, help="of images, pixels")


def run(options: argparse.Namespace) -> None:
    from lumitree.rendering.layers import check_denoiser

    check_denoiser()
    if unknown := sorted(set(options.scenes) - set(SCENES)):
        raise LumitreeError(f"no scenes {', '.join(unknown)}; expected {', '.join(SCENES)}")
    results = Results(options, goal=GOAL, width=options.width, path_depth=PATH_DEPTH)
    for each in ("output", "work", "rooms", "data"):
        setattr(options, each, getattr(options, each).resolve())
    rows: list[dict[str, Any]] = []
    for name in options.scenes or SCENES:
        rows.append(measure(name, options))
        facts, tables = results.setting(), (times_table(rows), points_table(rows))
        text = "\n".join(table.markdown() for table in tables)
        pictures = "".join(f"![{r['scene']}](finished-{r['scene']}.png)\n\n" for r in rows)
        page = f"# Time to a finished image\n\n{text}\n{pictures}{notes(facts)}"
        results.write({"setting": facts, "scenes": rows}, page)
        print("\n".join(table.text() for table in tables), flush=True)
