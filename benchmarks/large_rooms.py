"""Cost of many lamps in a furnished room, against one lamp in it.

    python -m benchmarks large_rooms ASSET ... [--counts 20 200] [--rooms hall office]

Two rooms, each with one lamp (the baseline) and with more, in a grid:

* `hall` grows with the lamps: each has a bay of 3 m x 3 m with a desk, a screen and a cupboard;
* `office` is always 12 m x 9 m, with twelve such bays. Lamps are smaller where they would touch.

Both are 2.8 m high, have diffuse surfaces but for the desks, and are seen from a corner. Assets
are shown by their light field, and by their geometry if they have one.

Writes `large_rooms.md` and `large_rooms.json`: CPU time of a sample in an image of many samples;
CPU time of recording the program of a pass in Python, which every pass of 2^19 samples takes once;
the time of a sample with its part of that; the variance of the pixels that show diffuse surfaces
alone, relative to their squared mean and without the 0.1 % of largest; and the product of both.
Each image is rendered by a process of its own, because programs contain all emitters of a process.
The processes of a room take turns.
"""

import argparse
import dataclasses
import multiprocessing
import statistics
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.furnished_room import BAY, furnished_room
from benchmarks.common.options import add_pixels, add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import MIN_ROUNDS, Clock
from benchmarks.equal_error.errors import trimmed_mean

PATH_DEPTH = 8
# Metres.
LAMP_HEIGHT, LAMP_SIZE = 2.1, 0.7
OFFICE_BAYS = (4, 3)
ROOMS = ("hall", "office")
# Samples of a pass of `lumitree.render` on a CPU.
PASS = 1 << 19
# Rays of a pixel, a side, that tell whether it shows diffuse surfaces alone.
STRATA = 4


@dataclasses.dataclass(frozen=True)
class Case:
    """An image that is measured."""

    asset: str
    appearance: Literal["field", "geometry"]
    room: str
    count: int
    width: int
    spp: int
    variant: str | None


def grid(count: int) -> tuple[int, int]:
    """Columns and rows of a number of lamps, as square as its divisors allow."""
    rows = max(n for n in range(1, int(count**0.5) + 1) if count % n == 0)
    return count // rows, rows


def scene_of(case: Case) -> Any:
    """The room of a case with its lamps (mi.Scene)."""
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import open_placements, place_luminaires

    columns, rows = grid(case.count)
    bays = OFFICE_BAYS if case.room == "office" else (columns, rows)
    steps = BAY * bays[0] / columns, BAY * bays[1] / rows
    size = min(LAMP_SIZE, 0.8 * min(steps))
    places = [
        ((i + 0.5) * steps[0], (j + 0.5) * steps[1]) for i in range(columns) for j in range(rows)
    ]
    lamps = [Placement(case.asset, at=(x, LAMP_HEIGHT, z), size=size) for x, z in places]
    empty: Any = furnished_room(*bays, case.width)
    return place_luminaires(empty, open_placements(lamps), appearance=case.appearance)


def shows_diffuse(scene: Any) -> NDArray[np.bool_]:
    """Mask [H, W] of the pixels that show diffuse surfaces alone, and no lamp before them."""
    import drjit as dr
    import mitsuba as mi

    from lumitree.core.device import on_device
    from lumitree.rendering.proxies import NONE, DividedScene

    sensor = scene.sensors()[0]
    width, height = sensor.film().size()
    steps = [np.arange(n * STRATA) for n in (height, width)]
    y, x = np.meshgrid(*((step + 0.5) / len(step) for step in steps), indexing="ij")
    position = on_device(mi.Point2f, np.stack([x.ravel(), y.ravel()], axis=1))
    ray, _ = sensor.sample_ray(0, 0.5, position, mi.Point2f(0.5))
    divided = DividedScene().of(scene)
    si = divided.surfaces.ray_intersect(ray)
    _, lamp = divided.proxies.first(ray, si.t, si.is_valid())
    other = mi.BSDFFlags.Glossy | mi.BSDFFlags.Delta
    good = si.is_valid() & (lamp == NONE) & ((si.bsdf().flags() & other) == 0)
    good &= ~si.shape.is_emitter()
    dr.eval(good)
    shape = height, STRATA, width, STRATA
    return np.asarray(np.array(good).reshape(shape).all(axis=(1, 3)), np.bool_)


def serve(connection: Connection, case: Case) -> None:
    """Render an image of a case for each seed that arrives, and send its times and pixels.

    Sends seconds of the image, seconds of an image of a few samples, and grey pixels of the mask.
    """
    from lumitree.core.backend import load_mitsuba

    mi = load_mitsuba(case.variant)
    scene = scene_of(case)
    mask = shows_diffuse(scene)
    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": PATH_DEPTH})
    small = mi.load_dict({"type": "radiancemeter", "film": {"type": "hdrfilm", "width": 1,
                          "height": 1, "rfilter": {"type": "box"}}})  # fmt: skip
    while (seed := connection.recv()) is not None:
        seconds = []
        for sensor, spp in ((small, 16), (scene.sensors()[0], case.spp)):
            clock = Clock()
            image = np.array(
                mi.render(scene, sensor=sensor, integrator=integrator, spp=spp, seed=seed)
            )
            seconds.append(clock.read()["cpu"])
        connection.send((*seconds, image[mask].mean(axis=-1)))


def measure(cases: list[Case], passes: int, seed: int) -> list[dict]:
    """Rows of the table, of cases that take turns; the first one is the baseline."""
    context = multiprocessing.get_context("spawn")
    workers = []
    for case in cases:
        ours, theirs = context.Pipe()
        process = context.Process(target=serve, args=(theirs, case), daemon=True)
        process.start()
        workers.append((process, ours))
    found: list[list[Any]] = [[] for _ in cases]
    # The first image compiles kernels: its times do not count.
    for index in range(passes + 1):
        for (_, connection), answers in zip(workers, found, strict=True):
            connection.send(seed + index)
            answers.append(connection.recv())
    for process, connection in workers:
        connection.send(None)
        process.join()
    return _with_ratios([_row(*each) for each in zip(cases, found, strict=True)])


def _row(case: Case, answers: list[Any]) -> dict:
    """Figures of one case."""
    recording = statistics.median(answer[0] for answer in answers[1:])
    image = statistics.median(answer[1] for answer in answers[1:])
    samples = case.spp * case.width * (case.width * 3 // 4)
    sample = (image - recording) / samples
    grey = np.stack([answer[2] for answer in answers])
    grey = grey[:, grey.any(axis=0)]
    relative = grey.var(axis=0, ddof=1) * case.spp / grey.mean(axis=0) ** 2
    return {
        "lamp": Path(case.asset).stem,
        "appearance": case.appearance,
        "room": case.room,
        "count": case.count,
        "sample_seconds": sample,
        "recording_seconds": recording,
        "seconds": sample + recording / PASS,
        "relative_variance": trimmed_mean(relative[None, :, None]),
    }


def _with_ratios(rows: list[dict]) -> list[dict]:
    """The rows with their figures over the first row's."""
    first = rows[0]
    for row in rows:
        row["time_ratio"] = row["seconds"] / first["seconds"]
        row["variance_ratio"] = row["relative_variance"] / first["relative_variance"]
        row["product"] = row["time_ratio"] * row["variance_ratio"]
    return rows


def table(rows: list[dict]) -> Table:
    """A line for each case."""
    heads = ["lamp", "shown by", "room", "lamps", "sample, µs", "recording, s", "time / one"]
    heads += ["relative variance", "variance / one", "product / one"]
    lines = [
        [
            row["lamp"],
            row["appearance"],
            row["room"],
            str(row["count"]),
            f"{1e6 * row['sample_seconds']:.2f}",
            f"{row['recording_seconds']:.2f}",
            f"{row['time_ratio']:.2f}",
            f"{row['relative_variance']:.2f}",
            f"{row['variance_ratio']:.2f}",
            f"{row['product']:.2f}",
        ]
        for row in rows
    ]
    return Table(heads, lines, left=3)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("assets", metavar="ASSET", nargs="+")
    parser.add_argument("--counts", type=int, nargs="+", metavar="N", default=[20, 200])
    parser.add_argument("--rooms", nargs="+", choices=ROOMS, default=list(ROOMS))
    parser.add_argument("--passes", type=int, default=MIN_ROUNDS, help="of each image")
    parser.add_argument(
        "--appearances", nargs="+", choices=("field", "geometry"), default=["field", "geometry"]
    )
    add_pixels(parser, "--width", 160, 16)
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    results = Results(options, path_depth=PATH_DEPTH, clock="cpu")
    rows: list[dict] = []
    for asset in options.assets:
        for appearance in options.appearances:
            for name in options.rooms:
                cases = [
                    Case(asset, appearance, name, n, options.width, options.spp, options.variant)
                    for n in (1, *options.counts)
                ]
                rows += measure(cases, options.passes, options.seed)
                facts = results.setting()
                text = f"# Large rooms\n\n{table(rows).markdown()}\n{notes(facts)}"
                results.write({"setting": facts, "cases": rows}, text)
                print(table(rows[-len(cases) :]).text(), flush=True)
