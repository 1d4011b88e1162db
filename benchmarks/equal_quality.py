"""Time at equal error of a lamp and of its bake: python benchmarks/equal_quality.py --help

One pair:   --luminaire bulbs --asset bulbs.lumitree --room room_night.xml --at x y z --size s
Many pairs: --pairs benchmarks/equal_quality_pairs.toml --rooms FOLDER --assets FOLDER

For each pair, with `--time` seconds of rendering in all:

* a long run of the explicit lamp (half the time): the reference. Its own error, from the spread of
  its independent batches, is stated, and nothing is compared below it;
* a long run of the baked lamp: its noise, and the *bake's error*, the difference of the two long
  runs with the noise of both subtracted;
* both methods with 1, 2, 4, ... samples a pixel, timed.

Everything is kept in the `--cache` folder under the hash of what it depends on. The same command
again spends its time on making the long runs longer. Readings (one row a pair):

* speedup: as in the paper's Table 5, the time for the RMSE that the baked lamp has at 32 samples.
  Its RMSE and the explicit lamp's time are expected values: the mean squared error is variance /
  samples (+ the bake's error), with the variance of the long runs; a sample's time is measured
  with both methods taking turns. Where rare samples are very bright, most pictures look better
  than they are on average, so this is the sound reading;
* lit: the same over the pixels whose rays do not meet the lamp's box. Camera paths find what shines
  in a lamp with little noise, whoever renders it, and filaments are a thousand times brighter than
  the room, so that they decide an RMSE of the whole picture. What a lamp is for is the rest. With
  fewer samples than 32 where the reference is not good enough for more, and as a bound (>) where
  one sample is better than the reference;
* lit, robust: the same pixels by relMSE, without the 0.1 % of them that are noisiest by either
  method: mirror images of filaments, which no sampling of lamps finds;
* measured: the first by the ladders' RMSE alone, marked ~ where it lies beyond the last rung;
* robust: the time for equal relMSE of the whole picture without the 0.1 % of the pixels with the
  largest errors, from the ladders as well.

Writes equal_quality.json, equal_quality.md and pictures into `--output`.
"""

import argparse
import dataclasses
import json
import tomllib
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import binary_dilation

import lumitree
from batches import LongRun, digest, ladder, pace, remember
from equal_quality_report import draw_curves, draw_pictures, level_table, table
from error_against_time import (
    Floats,
    Pace,
    noise,
    ratio_of_means,
    relative_weights,
    squared_difference,
    trimming,
)
from lumitree.core.backend import load_mitsuba
from lumitree.core.files import write_json
from readings import Reference, expected_levels, headline, levels, readable, rung_rows
from setting import setting

HERE = Path(__file__).parent
REFERENCE_SHARE, BAKED_SHARE, LADDER_SHARE = 0.5, 0.15, 0.175  # the last one twice
SEEN_RAYS = 16  # a pixel, to tell which show the lamp
# What a picture of the baked lamp depends on, besides its asset and the room.
_SOURCES = ("rendering", "octree", "asset", "core")


@dataclasses.dataclass(frozen=True)
class Pair:
    """A luminaire, its asset and where both hang in a room."""

    luminaire: str
    asset: str
    room: str
    at: tuple[float, float, float]
    size: float
    bake_seconds: float | None = None

    @property
    def lamp_name(self) -> str:
        """Built-in name, or the folder of a file (and the file's own name where it says more)."""
        path = Path(self.luminaire)
        if not path.suffix:
            return self.luminaire
        folder = path.resolve().parent.name
        return folder if path.stem == "luminaire" else f"{folder}-{path.stem}"

    @property
    def name(self) -> str:
        """For files."""
        return f"{self.lamp_name}-{Path(self.room).resolve().parent.name}"


class Method:
    """One way to render the pair: its long run and its ladder, and how to extend both."""

    def __init__(self, pair: Pair, baked: bool, args: argparse.Namespace) -> None:
        from lumitree.luminaire.luminaire import load_luminaire
        from lumitree.luminaire.scene_file import SceneFile
        from lumitree.rendering.placement import Placement
        from lumitree.rendering.scene import (
            PlacedLuminaire,
            load_scene,
            place_luminaires,
            render_scene,
            set_film_width,
        )

        room, _ = load_scene(pair.room)
        set_film_width(room, args.width)
        source = pair.asset if baked else pair.luminaire
        scene = place_luminaires(
            room, [PlacedLuminaire(Placement(source, at=pair.at, size=pair.size))]
        )
        mi = load_mitsuba()
        if baked:
            self.kind = "lumitree_path"
        else:
            self.kind = args.explicit or explicit_integrator(load_luminaire(source))
        key = {
            "room": digest(Path(pair.room), *SceneFile(pair.room).references()),
            "lamp": digest(Path(source)) if baked else load_luminaire(source).fingerprint,
            "at": pair.at,
            "size": pair.size,
            "integrator": self.kind,
            "path_depth": args.path_depth,
            "width": args.width,
            "mitsuba": mi.__version__,
            "code": code_digest() if baked or self.kind == "lumitree_path" else "",
        }
        self.folder = Path(args.cache) / f"{pair.name}-{digest(key)}"
        self.folder.mkdir(parents=True, exist_ok=True)
        remember(self.folder, {"source": source, **key})
        self.long = LongRun(self.folder / "long.npz")
        self.rungs: list[dict] = []

        def render_pair(samples: int, seed: int) -> Any:
            integrator = mi.load_dict({"type": self.kind, "max_depth": args.path_depth})
            return render_scene(
                scene, integrator, samples, seed=seed, name=f"{pair.name}, {self.kind}"
            )

        self.render, self.scene = render_pair, scene

    def spend(self, long_seconds: float, ladder_seconds: float) -> None:
        """Climb the ladder and extend the long run for so many seconds by the wall."""
        self.rungs = ladder(self.folder, self.render, ladder_seconds)
        self.long.extend(self.render, long_seconds)

    def variance(self) -> Floats:
        """Variance [H, W, 3] of a sample, from the long run."""
        return self.long.batches.var(0, ddof=1) * self.long.samples

    def pace(self, seconds: float, bias: float, weights: Any) -> Pace:
        """With the variance of the long run."""
        variance = noise(self.long.batches, weights) * self.long.samples_per_pixel
        return Pace(variance, seconds, bias)


def shows_lamp(baked: Any) -> NDArray[np.bool_]:
    """Mask [H, W, 1] of pixels in which the box of the lamp is seen, or next to one."""
    import drjit as dr
    import mitsuba as mi

    sensor = baked.sensors()[0]
    width, height = sensor.film().size()
    random = mi.PCG32(width * height * SEEN_RAYS)
    index = dr.arange(mi.UInt32, width * height * SEEN_RAYS) // SEEN_RAYS
    pixel = mi.Point2f(index % width, index // width)
    position = (pixel + mi.Point2f(random.next_float32(), random.next_float32())) / mi.Point2f(
        width, height
    )
    ray, _ = sensor.sample_ray(0, 0, position, mi.Point2f(0.5))
    hit = baked.ray_intersect_preliminary(ray)
    seen = np.array(hit.is_valid() & (hit.shape.emitter() != None))  # noqa: E711
    seen = seen.reshape(height, width, SEEN_RAYS).any(axis=2)
    return binary_dilation(seen, iterations=2)[..., None]


def explicit_integrator(luminaire: Any) -> str:
    """What the explicit lamp needs: `path`, or `volpath` or `volpathmis` for media and thin glass.

    Light that thin glass and alpha masks let through unbent is found by next-event estimation under
    `volpath` alone.
    """
    from lumitree.rendering.integrator import has_null_surfaces
    from lumitree.transport.tracing import integrator_kind

    kind = integrator_kind(luminaire)
    return "volpath" if kind == "path" and has_null_surfaces(luminaire.scene) else kind


def code_digest() -> str:
    """Hash of the package's code that renders a baked lamp."""
    package = Path(lumitree.__file__).parent
    return digest(*sorted(file for part in _SOURCES for file in (package / part).glob("*.py")))


def reading(
    explicit: Method, baked: Method, seconds: list[float], counts: list[int], weights: Any
) -> dict:
    """Expected errors, weighted, and what bounds them.

    Args:
        seconds: a sample of each method takes.
        counts: samples a pixel of the baked lamp.
        weights: [H, W, 3] of squared errors.
    """
    bias = squared_difference(baked.long.batches, explicit.long.batches, weights)
    paces = explicit.pace(seconds[0], 0.0, weights), baked.pace(seconds[1], bias.value, weights)
    samples = explicit.long.samples_per_pixel
    floor = paces[0].variance.value / samples
    rows = expected_levels(counts, *paces, floor)
    best = readable(rows)
    # The room's own light, whatever the errors are weighted with.
    means = ratio_of_means(*(method.long.batches * (weights > 0) for method in (baked, explicit)))
    return {
        "speedup": best["speedup"],
        "speedup_error": best["speedup_error"],
        "baked_spp": best["baked_spp"],
        # Where one sample is better than the reference: the time for the reference's own error.
        "speedup_bound": samples * seconds[0] / rows[0]["baked_seconds"],
        "levels": rows,
        "variance_ratio": paces[0].variance.value / paces[1].variance.value,
        "bake_mse": bias.value,
        "bake_mse_error": bias.error,
        "mean_ratio": means.value,
        "mean_ratio_error": means.error,
        "reference_rmse": float(np.sqrt(floor)),
    }


def compare(pair: Pair, explicit: Method, baked: Method, clock: str) -> dict:
    """The pair's row: every reading."""
    reference = Reference.of(explicit.long.batches)
    bias = squared_difference(baked.long.batches, explicit.long.batches)
    rows = {
        name: rung_rows(method.rungs, reference, clock)
        for name, method in (("explicit", explicit), ("baked", baked))
    }
    seconds = [each[clock] for each in pace([explicit.render, baked.render])]
    paces = explicit.pace(seconds[0], 0.0, 1.0), baked.pace(seconds[1], bias.value, 1.0)
    readings = levels(rows["explicit"], rows["baked"], paces, reference)
    best = headline(readings)
    lit = 1.0 - shows_lamp(baked.scene)
    relative = relative_weights(reference.picture)
    noisy = [method.variance() * relative * lit for method in (explicit, baked)]
    counts = [rung["spp"] for rung in rows["baked"]]
    parts = {
        name: reading(explicit, baked, seconds, counts, weights)
        for name, weights in (
            ("lit", lit / lit.mean()),
            ("lit_robust", relative * lit * trimming(*noisy)),
        )
    }
    saved = (best["explicit_seconds"] or 0.0) - best["baked_seconds"]
    means = ratio_of_means(baked.long.batches, explicit.long.batches)
    rel_mse = squared_difference(baked.long.batches, explicit.long.batches, reference.weights)
    return {
        "luminaire": pair.lamp_name,
        "room": Path(pair.room).resolve().parent.name,
        "speedup": best["speedup"],
        "speedup_error": best["speedup_error"],
        **{f"speedup_{name}": part["speedup"] for name, part in parts.items()},
        "speedup_measured": best["speedup_measured"],
        "speedup_robust": best["speedup_robust"],
        "at_paper_samples": best,
        "levels": readings,
        "seconds_per_sample": dict(zip(("explicit", "baked"), seconds, strict=True)),
        "lit_share": float(lit.mean()),
        **parts,
        "at": pair.at,
        "size": pair.size,
        "resolution": list(reference.picture.shape[1::-1]),
        "clock": clock,
        "integrators": [explicit.kind, baked.kind],
        "reference": reference.summary()
        | {"spp": explicit.long.samples_per_pixel, "seconds": explicit.long.seconds[clock]},
        "bake": {
            "mse": bias.value,
            "mse_error": bias.error,
            "rmse": float(np.sqrt(max(bias.value, 0.0))),
            "rel_mse": rel_mse.value,
            "rel_mse_error": rel_mse.error,
            "mean_ratio": means.value,
            "mean_ratio_error": means.error,
            "spp": baked.long.samples_per_pixel,
            "seconds": pair.bake_seconds,
            "break_even_pictures": (
                pair.bake_seconds / saved if pair.bake_seconds and saved > 0 else None
            ),
        },
        "ladders": rows,
    }


def run(pair: Pair, args: argparse.Namespace) -> dict:
    """Render what the budget allows, compare, draw."""
    explicit, baked = (Method(pair, is_baked, args) for is_baked in (False, True))
    budget = LADDER_SHARE * args.time
    explicit.spend(REFERENCE_SHARE * args.time, budget)
    baked.spend(BAKED_SHARE * args.time, budget)
    row = compare(pair, explicit, baked, args.clock)
    folder = Path(args.output) / "equal_quality"
    folder.mkdir(parents=True, exist_ok=True)
    row["pictures"] = [f"equal_quality/{pair.name}.png", f"equal_quality/{pair.name}-curves.png"]
    pictures, curves = (Path(args.output) / name for name in row["pictures"])
    draw_pictures(pictures, row, explicit.long.mean, explicit.rungs, baked.rungs)
    draw_curves(curves, row)
    return row


def read_pairs(path: Path, rooms: Path, assets: Path, data: Path) -> list[Pair]:
    """Pairs of a TOML file; heights become sizes by the luminaire's own proportions."""
    from lumitree.luminaire.luminaire import load_luminaire

    pairs = []
    for entry in tomllib.loads(path.read_text())["pair"]:
        name = entry["luminaire"]
        source = str(data / name) if name.endswith(".xml") else name
        size = load_luminaire(source).size
        pairs.append(
            Pair(
                luminaire=source,
                asset=str(assets / entry["asset"]),
                room=str(rooms / entry["room"] / "room_night.xml"),
                at=tuple(entry["at"]),
                size=float(entry["height"] * size.max() / size[1]),
                bake_seconds=entry.get("bake_seconds"),
            )
        )
    return pairs


def write(rows: list[dict], output: Path, facts: dict) -> None:
    """Both files; rows of other pairs that are there already stay."""
    path = output / "equal_quality.json"
    known = json.loads(path.read_text())["pairs"] if path.exists() else []
    names = {(row["luminaire"], row["room"]) for row in rows}
    rows = [row for row in known if (row["luminaire"], row["room"]) not in names] + rows
    write_json(path, {"setting": facts, "pairs": rows})
    notes = "".join(f"* {key}: {value}\n" for key, value in facts.items())
    text = f"# Time at equal error\n\n{table(rows)}\n{notes}\n"
    text += f"## Speed-up at the RMSE of the baked lamp's samples\n\n{level_table(rows)}\n"
    text += f"## The same where the lamp itself is not seen\n\n{level_table(rows, 'lit')}\n"
    text += f"## There, by relMSE without the noisiest 0.1 %\n\n{level_table(rows, 'lit_robust')}"
    (output / "equal_quality.md").write_text(text)


def arguments() -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.partition("\n\n")[0])
    parser.add_argument("--luminaire", help="built-in name or file")
    parser.add_argument("--asset", help="its bake, a .lumitree file")
    parser.add_argument("--room", help="Mitsuba scene file with a camera")
    parser.add_argument("--at", nargs=3, type=float, metavar=("X", "Y", "Z"), help="box centre")
    parser.add_argument("--size", type=float, help="largest side of its box, scene units")
    parser.add_argument("--bake-seconds", type=float, help="what the bake took, for the break-even")
    parser.add_argument("--pairs", type=Path, help="TOML file of pairs instead")
    parser.add_argument(
        "--rooms", type=Path, default=Path("rooms"), help="for --pairs: ROOM/room_night.xml"
    )
    parser.add_argument(
        "--data", type=Path, default=Path(), help="for --pairs: folder of luminaires"
    )
    parser.add_argument("--assets", type=Path, default=Path(), help="for --pairs: folder of assets")
    parser.add_argument("--time", type=float, default=240, help="seconds a pair, by the wall (240)")
    parser.add_argument("--width", type=int, default=240, help="of the pictures, pixels (240)")
    parser.add_argument("--path-depth", type=int, default=64, help="longest path (64)")
    parser.add_argument("--explicit", help="the explicit lamp's integrator (default: as it needs)")
    parser.add_argument("--clock", choices=("wall", "cpu"), default="wall", help="what times mean")
    parser.add_argument("--cache", type=Path, default=Path("equal-quality.work"))
    parser.add_argument("--output", type=Path, default=HERE / "results")
    args = parser.parse_args()
    one = (args.luminaire, args.asset, args.room, args.at, args.size)
    if (args.pairs is None) == any(value is None for value in one):
        parser.error("give --pairs, or all of --luminaire --asset --room --at --size")
    return args


def main() -> None:
    args = arguments()
    load_mitsuba()
    if args.pairs is not None:
        pairs = read_pairs(args.pairs, args.rooms, args.assets, args.data)
    else:
        at = tuple(args.at)
        pairs = [Pair(args.luminaire, args.asset, args.room, at, args.size, args.bake_seconds)]
    facts = setting(seconds_a_pair=args.time, clock=args.clock, path_depth=args.path_depth)
    for pair in pairs:
        row = run(pair, args)
        write([row], args.output, facts)
        print(table([row]))


if __name__ == "__main__":
    main()
