"""Designs: time, flux saved against equal dimming, and against a search by simulations.

    python -m benchmarks design LAMP [PART ...] [--rooms FOLDER] [--evaluations N]

LAMP is an asset, placed with 2,000 lm. A part is a room, whose lamps are dimmed, and then moved too
along x and z: `office` with 12 lamps and 1,000 points, `demo` with 9 and a window, `living` with 6,
of FOLDER/living_room. A task and a plane around it need a least illuminance at each point.
*Equal* is one level for all lamps at first. *Mean* and *smallest*: differences of prediction and
simulation. CPU time is of all cores. The part `search` minimises the flux of 6 lamps in the office,
by `lumitree.design` and by `scipy.optimize.differential_evolution` with N simulations of 5 s at
most; a last simulation scales both to the same smallest illuminance.

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
# Height and size of lamps in the search, their least illuminance, lx, and candidates a generation.
HEIGHT, SIZE, LEAST, CANDIDATES = 2.4, 0.3, 150.0, 20
# Centre, extent, spacing and least illuminance, lx, of the task and of the plane around it; centre,
# numbers, pitch and size of the lamps.
ROOMS: dict[str, tuple[tuple[Any, ...], tuple[Any, ...], tuple[Any, ...]]] = {
    "office": (
        ((0, 0.745, -1.05), (1.6, 0.8), 0.1, 500),
        ((0, 0.75, 0), (4, 3), 0.116, 200),
        ((0, 2.4, 0), (4, 3), (1, 1), 0.3),
    ),
    "demo": (
        ((0, 0.9, 0), (1, 1), 0.1, 250),
        ((0, 1, 0), (3.6, 3.6), 0.3, 100),
        ((0, 2.25, 0), (3, 3), (1.2, 1.2), 0.2),
    ),
    "living": (
        ((2.72, 0.75, -1.6), (0.6, 0.6), 0.1, 200),
        ((2.4, 1.2, -1.6), (3.6, 2.4), 0.3, 40),
        ((2.4, 2.55, -1.6), (3, 2), (1.2, 1.4), 0.25),
    ),
}


def measure(name: str, options: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of a room: dimmed, and moved too."""
    import lumitree
    from lumitree.rendering.demo_room import demo_room

    living = options.rooms / "living_room" / "room_night.xml"
    scene = {"office": OFFICE, "demo": None, "living": living}[name] or demo_room()
    *areas, (centre, grid, pitch, size) = ROOMS[name]
    planes = [
        lumitree.TaskPlane(at, extent=extent, spacing=spacing, minimum=least, name=of)
        for of, (at, extent, spacing, least) in zip(("task", "room"), areas, strict=True)
    ]
    lamps = lumitree.Placement(options.lamp, centre, size, lumens=LUMENS, grid=grid, pitch=pitch)
    rows = []
    for change, move in (("dimmed", None), ("moved", {"*": "xz"})):
        clock = Clock()
        result = lumitree.design(
            scene, [lamps], planes=planes, move=move, brightest=2.0, error=options.error,
            time=60, variant=options.variant,
        )  # fmt: skip
        parts: Any = result.before.by_lamp
        fixed, *lit = parts.direct + parts.reflected
        least = np.concatenate([np.full(a.before.count, a.plane.minimum) for a in result.areas])
        # One level for all lamps.
        level = float(np.nanmax((least - fixed) / np.sum(lit, axis=0)))
        row: dict[str, Any] = {"room": name, "change": change, "lamps": len(result.lamps)}
        row |= {"points": len(least), "lumens": result.cost, **clock.read()}
        row["equal"] = level * result.cost_before
        for of in ("mean", "smallest"):
            pairs = [(getattr(a.simulated, of), getattr(a.predicted, of)) for a in result.areas]
            row[f"{of}_difference"] = max(abs(lux / expected - 1) for lux, expected in pairs)
        rows.append(row)
        if options.plans is not None:
            result.save(options.plans / f"{name}-{change}.png")
    return rows


def search(options: argparse.Namespace) -> list[dict[str, Any]]:
    """Rows of both searches."""
    from scipy.optimize import differential_evolution

    import lumitree
    from lumitree.core.backend import load_rgb
    from lumitree.rendering.scene import load_without_camera

    mi = load_rgb(options.variant)
    scene, _ = load_without_camera(OFFICE)
    # All simulations share its tables on the device.
    _kept = mi.load_dict(lumitree.shape(options.lamp))
    plane = lumitree.TaskPlane((0, 0.75, 0), extent=(4, 3), spacing=0.4, minimum=LEAST)

    def least(lamps: Sequence[Any], error: float, time: float, seed: int) -> float:
        settings: dict[str, Any] = {"error": error, "time": time, "seed": seed, "progress": None}
        return lumitree.illuminance(scene, lamps, planes=[plane], **settings).areas[0].smallest

    def lamps_of(values: Any) -> list[Any]:
        places, levels = values[:12].reshape(6, 2).tolist(), values[12:].tolist()
        return [
            lumitree.Placement(options.lamp, (x, HEIGHT, z), SIZE, lumens=LUMENS).dimmed(level)
            for (x, z), level in zip(places, levels, strict=True)
        ]

    def cost(values: Any) -> float:
        found = least(lamps_of(values), 2 * options.error, 5, 0)
        return float(values[12:].sum() * LUMENS * LEAST / max(found, 1e-9))

    bounds = [(-1.8, 1.8), (-1.3, 1.3)] * 6 + [(0.1, 1.0)] * 6
    first = [x for z in (-0.75, 0.75) for x in (-1.3, z, 0, z, 1.3, z)] + [0.5] * 6
    low, high = np.array(bounds).T
    random = np.random.default_rng(0).uniform(low, high, (CANDIDATES - 1, len(bounds)))
    rows = []
    for name in ("design", "differential evolution"):
        clock = Clock()
        if name == "design":
            result = lumitree.design(
                scene, lamps_of(np.array(first)), planes=[plane], move={"*": "xz"},
                error=options.error, time=60, brightest=2.0,
            )  # fmt: skip
            lamps, lumens = result.placements, result.cost
        else:
            start = cast(Any, np.vstack([first, random]))
            generations = options.evaluations // CANDIDATES - 1
            found = differential_evolution(
                cost, bounds, init=start, maxiter=generations, polish=False, tol=0, rng=0
            )
            lamps, lumens = lamps_of(found.x), float(found.x[12:].sum() * LUMENS)
        times = clock.read()
        scaled = lumens * LEAST / least(lamps, options.error / 2, 120, 1)
        rows.append({"search": name, "lumens": scaled, **times})
    return rows


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("lamp", metavar="LAMP", help="a .lumitree file")
    parser.add_argument("parts", metavar="PART", nargs="*", help=f"of {', '.join(PARTS)}")
    parser.add_argument("--rooms", metavar="FOLDER", type=Path, default=Path("rooms"))
    parser.add_argument("--plans", metavar="FOLDER", type=Path, help="PNG: docs/images/design.jpg")
    parser.add_argument("--error", type=float, default=0.02, help="of each point")
    parser.add_argument("--evaluations", type=int, default=200, help="of the search")


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
    heads = "room,lamps,number,points,flux (lm),equal (lm),saved,mean,smallest,CPU (s)"
    rows = [
        (row["room"], row["change"], f"{row['lamps']}", f"{row['points']:,}",
         f"{row['lumens']:,.0f}", f"{row['equal']:,.0f}", f"{1 - row['lumens'] / row['equal']:.0%}",
         f"{row['mean_difference']:.1%}", f"{row['smallest_difference']:.1%}",
         f"{row['cpu']:.0f}")
        for each in report["rooms"].values() for row in each
    ]  # fmt: skip
    slow = report["search"][-1:]
    searches = [
        (row["search"], f"{row['lumens']:,.0f}", f"{row['lumens'] / slow[0]['lumens']:.3f}",
         f"{row['cpu']:.0f}", f"{row['cpu'] / slow[0]['cpu']:.3f}")
        for row in report["search"]
    ]  # fmt: skip
    found = Table(("search", "flux (lm)", "ratio", "CPU (s)", "ratio"), searches)
    return [Table(heads.split(","), rows, 2), *[found] * len(slow)]
