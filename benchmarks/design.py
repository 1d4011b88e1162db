"""Designs: time, flux saved against equal dimming, and against a search by simulations.

    python -m benchmarks design LAMP [PART ...] [--rooms FOLDER] [--evaluations N]

LAMP is an asset, which is placed with 2,000 lm. A part is a room, whose lamps are dimmed, and then
also moved along x and z: `office` has 12 lamps and 1,000 points, `demo` 9 lamps and a window, and
`living` 6 lamps, of FOLDER/living_room. Each room has a task and a plane around it, with the least
illuminance of each point. *Equal* is one dim level for all lamps with the same smallest illuminance
on each plane, at the first places. CPU time is of all cores; half of it is a bound for two.

The part `search` minimises the flux of 6 lamps in the office by their places and levels, once by
`lumitree.design` and once by `scipy.optimize.differential_evolution` with N simulations. The flux
of both is scaled to the same smallest illuminance in a last simulation.

Writes `design.md` and `design.json`.
"""

import argparse
from collections.abc import Sequence
from pathlib import Path
from typing import Any, cast

import numpy as np

from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import Clock

OFFICE = Path(__file__).parents[1] / "examples" / "office.xml"
PARTS = ("office", "demo", "living", "search")
LUMENS = 2000.0
# Least illuminance in the search, lx, and candidates of a generation.
LEAST, CANDIDATES = 150.0, 20


def room(name: str, folder: Path) -> tuple[Any, list[Any], tuple[tuple[float, ...], float]]:
    """Scene, planes, and centre, size and numbers of the array of lamps, in a room."""
    import lumitree
    from lumitree.rendering.demo_room import demo_room

    def plane(name: str, centre: Any, extent: Any, spacing: float, minimum: float) -> Any:
        task = {"extent": extent, "spacing": spacing, "minimum": minimum, "name": name}
        return lumitree.TaskPlane(centre, **task)

    if name == "demo":
        table = plane("table", (0, 0.9, 0), (1, 1), 0.1, 250)
        return (
            demo_room(),
            [table, plane("room", (0, 1, 0), (3.6, 3.6), 0.3, 100)],
            (
                (0, 2.25, 0, 3, 3, 1.2, 1.2),
                0.2,
            ),
        )
    if name == "living":
        table = plane("table", (2.72, 0.75, -1.6), (0.6, 0.6), 0.1, 200)
        return (
            folder / "living_room" / "room_night.xml",
            [table, plane("room", (2.4, 1.2, -1.6), (3.6, 2.4), 0.3, 40)],
            ((2.4, 2.55, -1.6, 3, 2, 1.2, 1.4), 0.25),
        )
    desk = plane("desk", (0, 0.745, -1.05), (1.6, 0.8), 0.1, 500)
    around = plane("room", (0, 0.75, 0), (4, 3), 0.116, 200)
    return OFFICE, [desk, around], ((0, 2.4, 0, 4, 3, 1, 1), 0.3)


def measure(name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of a room: dimmed, and moved too."""
    import lumitree

    scene, planes, (array, size) = room(name, options.rooms)
    x, y, z, columns, lines, across, along = array
    lamps = lumitree.Placement(
        options.lamp, (x, y, z), size, lumens=LUMENS, label="lamp",
        grid=(int(columns), int(lines)), pitch=(across, along),
    )  # fmt: skip
    rows = []
    for change, move in (("dimmed", None), ("moved", {"*": "xz"})):
        clock = Clock()
        result = lumitree.design(
            scene, [lamps], planes=planes, move=move, brightest=2.0, error=options.error,
            time=60, variant=options.variant,
        )  # fmt: skip
        rows.append(
            {
                "room": name,
                "change": change,
                "lamps": len(result.lamps),
                "points": sum(area.simulated.count for area in result.areas),
                "lumens": result.cost,
                # The first places have the least common level: the design may move.
                "equal": equal(result),
                **{
                    f"{of}_difference": max(
                        abs(getattr(area.simulated, of) / getattr(area.predicted, of) - 1)
                        for area in result.areas
                    )
                    for of in ("mean", "smallest")
                },
                "levels": [lamp.level for lamp in result.lamps],
                "stages": result.seconds,
                **clock.read(),
            }
        )
        if options.plans is not None:
            result.save(options.plans / f"{name}-{change}.png")
    return rows


def equal(result: Any) -> float:
    """Flux of equal levels at the first places, with which each plane has what it needs."""
    ratios = [area.plane.minimum / area.before.smallest for area in result.areas]
    return result.cost_before * max(ratios)


def search(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of both searches."""
    from scipy.optimize import differential_evolution

    import lumitree
    from lumitree.rendering.scene import load_without_camera

    scene, _ = load_without_camera(OFFICE)
    plane = lumitree.TaskPlane((0, 0.75, 0), extent=(4, 3), spacing=0.25, minimum=LEAST)
    grid = lumitree.Placement(
        options.lamp, (0, 2.4, 0), 0.3, lumens=LUMENS, grid=(3, 2), pitch=(1.3, 1.5)
    ).each()

    def lux(lamps: Sequence[Any], error: float, seed: int) -> float:
        settings: dict[str, Any] = {"error": error, "seed": seed, "progress": None}
        return lumitree.illuminance(scene, lamps, planes=[plane], **settings).areas[0].smallest

    def lamps_of(values: np.ndarray) -> list[Any]:
        places, levels = values[:12].reshape(6, 2).tolist(), values[12:].tolist()
        return [
            lumitree.Placement(options.lamp, (x, 2.4, z), 0.3, lumens=LUMENS).dimmed(level)
            for (x, z), level in zip(places, levels, strict=True)
        ]

    def cost(values: np.ndarray) -> float:
        least = lux(lamps_of(values), 2 * options.error, 0)
        return float(values[12:].sum() * LUMENS * LEAST / max(least, 1e-9))

    bounds = [(-1.8, 1.8), (-1.3, 1.3)] * 6 + [(0.1, 1.0)] * 6
    low, high = np.array(bounds).T
    first = np.append(np.array([lamp.at for lamp in grid])[:, [0, 2]].ravel(), np.full(6, 0.5))
    random = np.random.default_rng(0).uniform(low, high, (CANDIDATES - 1, len(bounds)))
    generations = max(options.evaluations // CANDIDATES - 1, 0)
    rows = []
    for name in ("design", "differential evolution"):
        clock = Clock()
        if name == "design":
            result = lumitree.design(
                scene, grid, planes=[plane], move={"*": "xz"}, error=options.error, brightest=2.0
            )
            lamps, lumens = result.placements, result.cost
        else:
            start = cast(Any, np.vstack([first, random]))
            found = differential_evolution(
                cost, bounds, init=start, maxiter=generations, polish=False, tol=0, rng=0
            )
            lamps, lumens = lamps_of(found.x), float(found.x[12:].sum() * LUMENS)
        times = clock.read()
        scaled = lumens * LEAST / lux(lamps, options.error / 2, 1)
        rows.append({"search": name, "lumens": scaled, **times})
    return rows


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("lamp", metavar="LAMP", help="a .lumitree file")
    parser.add_argument("parts", metavar="PART", nargs="*", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--rooms", metavar="FOLDER", type=Path, default=Path("rooms"))
    parser.add_argument("--plans", metavar="FOLDER", type=Path, help="for the plans as PNG")
    parser.add_argument("--error", type=float, default=0.02, help="of each point")
    parser.add_argument("--evaluations", type=int, default=200, help="simulations of the search")


def run(options: argparse.Namespace) -> None:
    results = Results(options, lumens=LUMENS, error=options.error)
    report: dict[str, Any] = results.stored({"rooms": {}, "search": []})
    for part in options.parts or PARTS:
        if part == "search":
            report["search"] = search(options)
        else:
            report["rooms"][part] = measure(part, options)
        report["setting"] = results.setting()
        text = "\n".join(table.markdown() for table in tables(report))
        results.write(report, f"# Designs\n\n{text}\n{notes(report['setting'])}")
        print(*(table.text() for table in tables(report)), sep="\n")


def tables(report: dict[str, Any]) -> list[Table]:
    """The tables of a report."""
    heads = ("room", "lamps", "lamps, points", "flux, lm", "equal, lm", "saved")
    heads += ("mean, simulated", "smallest, simulated", "CPU, s")
    rows = [
        (
            row["room"], row["change"], f"{row['lamps']}, {row['points']:,}",
            f"{row['lumens']:,.0f}", f"{row['equal']:,.0f}",
            f"{1 - row['lumens'] / row['equal']:.0%}", f"± {row['mean_difference']:.1%}",
            f"± {row['smallest_difference']:.1%}", f"{row['cpu']:.0f}",
        )
        for each in report["rooms"].values()
        for row in each
    ]  # fmt: skip
    found = [Table(heads, rows, 2)]
    if report["search"]:
        slow = report["search"][-1]
        searches = [
            (
                row["search"], f"{row['lumens']:,.0f}", f"{row['lumens'] / slow['lumens']:.3f}",
                f"{row['cpu']:.0f}", f"{row['cpu'] / slow['cpu']:.3f}",
            )
            for row in report["search"]
        ]  # fmt: skip
        found.append(Table(("search", "flux, lm", "ratio", "CPU, s", "ratio"), searches))
    return found
