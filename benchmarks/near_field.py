"""Light inside the box of a lamp: irradiance and noise.

    python -m benchmarks near_field [--data FOLDER] [LUMINAIRE ...]

Irradiance of both sides of patches on planes across the lamp's box: four horizontal ones (3, 25, 50
and 75 % of the box's height), one that touches the box from below (2 % below it) and two vertical
ones. The side of a plane with more light counts. The reference are light paths that cross the
patches. Patches are *far* (more than a tenth of the box's longest half side from the lamp's
surfaces) or *near*; those in closed parts of the lamp do not count. RMS differences are without the
noise of either side, which needs two bakes. There are two ways to receive the light: with the
lamp's surfaces in the scene (`geometry`), and without (`light`).

Further figures: light in the shadow under a lamp, relative to the brightest patches; time times
variance of a receiver in the box over a receiver just outside it. `--data` adds luminaires of
others.

Writes `near_field.md` and `near_field.json`.
"""

import argparse
import dataclasses
import sys
import tempfile
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.common.lamps import DATA, OVERRIDES, file_name
from benchmarks.common.options import add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.inside_box.figures import PatchErrors, masks, over_planes, patch_errors, shadow
from benchmarks.inside_box.patches import Floats, Rectangle, surroundings
from lumitree.lamp.source import LuminaireSource

LAMPS = ("bulbs", "neoclassical", "arc")
DATA_LAMPS = ("little_lamp", "megeon_chandelier/luminaire.xml", "stained_glass_lamp")
# Up is y in all of them.
HORIZONTAL = tuple(Rectangle(1, height, 8) for height in (0.03, 0.25, 0.5, 0.75))
TOUCHING = Rectangle(1, -0.02, 8)
VERTICAL = (Rectangle(0, 0.3, 8), Rectangle(2, 0.3, 8))
PLANES = (*HORIZONTAL, TOUCHING, *VERTICAL)
KINDS = {"horizontal": HORIZONTAL, "touching": (TOUCHING,), "vertical": VERTICAL}
# Columns of the table of luminaires: planes, and kind of patches.
GROUPS = (("horizontal", "far"), ("horizontal", "near"), ("touching", "all"), ("vertical", "far"))
# For the shadow under a lamp.
FINE = Rectangle(1, -0.02, 48, part=1.0)
# Appearance of the lamp, by the name of the way to receive its light.
WAYS: dict[str, Literal["geometry", "field"]] = {"geometry": "geometry", "light": "field"}
# Receivers whose noise is measured are in patches with this part of their plane's largest
# irradiance.
LIT = 0.1
# Patches of a kind that get a smaller part of a plane's light do not count: a lamp in its shade
# lights a plane through the shade nowhere else.
DARK = 0.01


@dataclasses.dataclass(frozen=True, eq=False)
class Plane:
    """A plane of a luminaire, and what is known of it.

    Attributes:
        rectangle: where it is.
        side: the one that gets more light.
        reference: [B, P, P] irradiance of that side.
        masks: patches [P, P] by kind.
    """

    rectangle: Rectangle
    side: int
    reference: Floats
    masks: dict[str, NDArray[np.bool_]]

    def errors(self, baked: Floats) -> dict[str, PatchErrors | None]:
        """Errors of irradiance [2, 2, P, P] by kind of patches; None for kinds in the dark."""
        mean = self.reference.mean(axis=0)
        light = mean[self.masks["all"]].sum()
        return {
            kind: patch_errors(baked, self.reference, mask)
            if mean[mask].sum() >= DARK * light
            else None
            for kind, mask in self.masks.items()
        }

    @property
    def lit_from(self) -> str:
        """The direction from which its light comes, such as "+y"."""
        return "+-"[self.side] + "xyz"[self.rectangle.axis]


def measure(source: LuminaireSource, folder: Path, options: argparse.Namespace) -> dict[str, Any]:
    """A row for a luminaire: its planes, and its other figures."""
    from benchmarks.inside_box.baked import BakedLamp, receiver_noise

    assets = [_baked(source, folder, options, number) for number in (0, 1)]
    planes, fine = reference_planes(source, options)
    row: dict[str, Any] = {
        "luminaire": assets[0].luminaire,
        "planes": [
            {
                "plane": plane.rectangle.name,
                "lit_from": plane.lit_from,
                "reference": float(plane.reference.mean()),
            }
            for plane in planes
        ],
    }
    for way, appearance in WAYS.items():
        lamps = [BakedLamp(asset, appearance) for asset in assets]
        found = {
            plane.rectangle: plane.errors(_baked_patches(lamps, plane, options.seed))
            for plane in planes
        }
        for each, errors in zip(row["planes"], found.values(), strict=True):
            each[way] = {k: v and dataclasses.asdict(v) for k, v in errors.items()}
        row[way] = {
            name: {
                kind: over_planes([e for r in group if (e := found[r][kind]) is not None])
                for kind in ("far", "near", "all")
            }
            for name, group in KINDS.items()
        }
        row[way]["shadow"] = _shadow(lamps, fine, options.seed)
        row[way]["noise"] = receiver_noise(lamps[0], _receivers(lamps[0], planes), options.seed)
    return row


def _baked_patches(lamps: list[Any], plane: Plane, seed: int) -> Floats:
    """Irradiance [2, 2, P, P] of a plane by bake and set of samples."""
    return np.array(
        [
            [lamp.patches(plane.rectangle, plane.side, seed + 2 * bake + draw) for draw in (0, 1)]
            for bake, lamp in enumerate(lamps)
        ]
    )


def _shadow(lamps: list[Any], fine: Plane, seed: int) -> dict[str, float] | None:
    baked = _baked_patches(lamps, fine, seed).mean(axis=(0, 1))
    return shadow(baked, fine.reference.mean(axis=0))


def reference_planes(
    source: LuminaireSource, options: argparse.Namespace
) -> tuple[list[Plane], Plane]:
    """The planes of a luminaire, and the fine one below it."""
    from benchmarks.inside_box.crossings import crossing_irradiance
    from lumitree.lamp.luminaire import load_luminaire

    luminaire = load_luminaire(source)
    rectangles = [*PLANES, FINE]
    planes = []
    for rectangle, values in zip(
        rectangles,
        crossing_irradiance(luminaire, rectangles, options.paths, options.seed),
        strict=True,
    ):
        side = int(values.mean(axis=(0, 2, 3)).argmax())
        found = {} if rectangle is FINE else masks(*surroundings(luminaire, rectangle))
        planes.append(Plane(rectangle, side, values[:, side], found))
    return planes[:-1], planes[-1]


def _receivers(lamp: Any, planes: list[Plane]) -> dict[str, list[tuple[Floats, int, int]]]:
    """Receivers in the box, and just outside it: centres of far patches that get light."""
    groups: dict[str, list[tuple[Floats, int, int]]] = {"inside": [], "outside": []}
    for plane in planes:
        if plane.rectangle.axis != 1:
            continue
        mean = plane.reference.mean(axis=0)
        lit = plane.masks["far"] & (mean > LIT * mean.max())
        points = lamp.centres(plane.rectangle)[lit]
        if len(points):
            group = "outside" if plane.rectangle is TOUCHING else "inside"
            groups[group].append((points, plane.rectangle.axis, plane.side))
    return groups


def _baked(source: LuminaireSource, folder: Path, options: argparse.Namespace, number: int) -> Any:
    """An asset, which is baked where it is missing."""
    import lumitree

    path = folder / f"{file_name(source)}-{number}.lumitree"
    if path.exists():
        return lumitree.load(path)
    return lumitree.bake(
        source,
        path,
        lumitree.BakeConfig(
            parts=("light", "geometry"), irradiance_paths=0, seed=options.seed + number
        ),
    ).asset


def plane_table(rows: list[dict[str, Any]]) -> Table:
    """A line for each luminaire and plane."""
    heads = ["luminaire", "plane", "lit from", "far patches", "ratio", "RMS"]
    heads += ["near patches", "ratio", "RMS", "without geometry, far: ratio", "RMS"]
    lines = []
    for row in rows:
        for plane in row["planes"]:
            geometry = plane["geometry"]
            line = [row["luminaire"], plane["plane"], plane["lit_from"]]
            for kind in ("far", "near"):
                count = "0" if geometry[kind] is None else str(geometry[kind]["patches"])
                line += [count, *_errors(geometry[kind])]
            lines.append([*line, *_errors(plane["light"]["far"])])
    return Table(heads, lines, left=3)


def _errors(errors: dict[str, Any] | None) -> list[str]:
    """Cells of a ratio and an RMS, with their standard errors where they are known."""
    if errors is None:
        return ["-", "-"]
    ratio, rms = f"{errors['ratio']:.3f}", f"{100 * errors['rms']:.1f}"
    if "ratio_error" in errors:
        ratio += f" ± {errors['ratio_error']:.3f}"
        rms += f" ± {100 * errors['rms_error']:.1f}"
    return [ratio, f"{rms} %"]


def lamp_table(rows: list[dict[str, Any]]) -> Table:
    """A line for each luminaire and way to receive its light, and the means over luminaires."""
    heads = ["luminaire", "received", "far: ratio", "RMS", "one bake", "near: ratio", "RMS"]
    heads += ["touching: ratio", "RMS", "vertical, far: ratio", "RMS"]
    heads += ["in shadow", "reference", "time * variance / outside"]
    lines = []
    for way in WAYS:
        for row in rows:
            found, one = row[way], row[way]["horizontal"]["far"]
            dark = found["shadow"]
            line = [row["luminaire"], way]
            for number, (group, kind) in enumerate(GROUPS):
                line += _errors(found[group][kind])
                if number == 0:
                    line.append("-" if one is None else f"{100 * one['rms_of_one']:.1f} %")
            for name in ("baked", "reference"):
                line.append("-" if dark is None else f"{dark[name]:.3f}")
            ratio = _noise_ratio(found)
            lines.append([*line, "-" if ratio is None else f"{ratio:.2f}"])
        lines.append(_mean_line([row[way] for row in rows], way))
    return Table(heads, lines, left=2)


def _mean_line(rows: list[dict[str, Any]], way: str) -> list[str]:
    """Mean ratios, root mean squares of the RMS, and the geometric mean of the last column."""
    line = ["mean", way]
    for number, (group, kind) in enumerate(GROUPS):
        known = [row[group][kind] for row in rows if row[group][kind] is not None]
        mean = None
        if known:
            square = np.mean([each["rms"] ** 2 for each in known])
            mean = {"ratio": np.mean([each["ratio"] for each in known]), "rms": np.sqrt(square)}
        line += [*_errors(mean), *([""] if number == 0 else [])]
    noise = [np.log(ratio) for row in rows if (ratio := _noise_ratio(row)) is not None]
    return [*line, "", "", f"{np.exp(np.mean(noise)):.2f}" if noise else "-"]


def _noise_ratio(found: dict[str, Any]) -> float | None:
    """Time times variance of receivers in the box, over receivers just outside it."""
    noise = found["noise"]
    return noise and noise["inside"]["product"] / noise["outside"]["product"]


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaires", metavar="LUMINAIRE", nargs="*", default=list(LAMPS))
    parser.add_argument("--data", metavar="FOLDER", type=Path, help="with the luminaires of others")
    parser.add_argument(
        "--assets", type=Path, metavar="FOLDER", help="where assets are kept (default: nowhere)"
    )
    parser.add_argument(
        "--paths", type=int, metavar="N", default=1 << 24, help="light paths of the reference"
    )
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    results = Results(options, paths=options.paths, baseline="explicit lamp", clock="cpu")
    report: dict[str, Any] = {"luminaires": []}
    with tempfile.TemporaryDirectory() as scratch:
        folder = options.assets or Path(scratch)
        folder.mkdir(parents=True, exist_ok=True)
        sources = [LuminaireSource(name) for name in options.luminaires]
        sources += [] if options.data is None else _data_sources(options.data)
        for source in sources:
            report["luminaires"].append(measure(source, folder, options))
            # After every row: all of them take minutes.
            _write(results, report)
            print(f"measured {file_name(source)}", file=sys.stderr)
    print(_write(results, report))


def _data_sources(data: Path) -> list[LuminaireSource]:
    """The luminaires of `DATA_LAMPS` in a folder."""
    return [
        LuminaireSource(
            str(data / file), materials=None if overrides is None else str(OVERRIDES / overrides)
        )
        for file, overrides, _ in DATA
        if file.startswith(DATA_LAMPS)
    ]


def _write(results: Results, report: dict[str, Any]) -> str:
    """Write the result files; returns the tables as text."""
    rows, facts = report["luminaires"], results.setting()
    tables = [lamp_table(rows), plane_table(rows)]
    text = "\n".join(table.markdown() for table in tables)
    results.write({"setting": facts, **report}, f"# Inside the box\n\n{text}\n{notes(facts)}")
    return "\n".join(table.text() for table in tables)
