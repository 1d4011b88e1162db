"""The baked lamp against all other ways to render the same lamp in the same room.

    python -m benchmarks rivals --work FOLDER [--luxcore PYTHON] [--blender PYTHON] [LUMINAIRE ...]

Each luminaire hangs in the demonstration's room, whose plastics are replaced by diffuse surfaces,
which all renderers have alike, and whose window emits half the luminous flux of the lamp. Each
method makes independent images until they have cost `--seconds` CPU seconds, without the
preparation. They are kept in the folder `--work`: the same command again goes on where the last one
ended, and `--seconds 0` makes the tables of the images that are there. Without `--luxcore`, a
Python with the module pyluxcore, and `--blender`, a Python with bpy or Blender, their methods are
left out.

Figures of each method: CPU time of a sample a pixel; variance of a sample relative to the squared
mean, in the mean over the pixels that show diffuse surfaces of the room, without the 0.1 % of
largest; the product of both over the baked lamp's; the mean brightness of these surfaces over the
explicit lamp's by `lumitree_path`; the CPU time of a whole image to an `rmse_display` of 8, 5 and
2.7 by noise alone; its `rmse_display` without noise, against the explicit lamp's image by
`lumitree_path`; and the noise of diffuse surfaces in images that are denoised (optional extra
`denoise`). Writes `rivals.md`, `rivals.json` and, for each luminaire,
`rivals-LUMINAIRE.png`: the images of all methods at equal time.
"""

import argparse
import dataclasses
import sys
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.demo_lamps import flux_in_room, placed, shows_diffuse
from benchmarks.common.lamps import file_name
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.equal_error.batches import LongRun, digest
from benchmarks.equal_error.errors import DISPLAY_LEVELS
from benchmarks.rival_methods.cycles_methods import cycles_methods
from benchmarks.rival_methods.denoising import Guides, denoised_noise
from benchmarks.rival_methods.figures import TOLERANCE, bias_text, figures, time_text
from benchmarks.rival_methods.luxcore import find_luxcore, luxcore_methods
from benchmarks.rival_methods.method import PATH_DEPTH, Method, extend, opened_run
from benchmarks.rival_methods.mitsuba_methods import mitsuba_methods
from benchmarks.rival_methods.room import Room
from lumitree.errors import LumitreeError
from lumitree.lamp.source import LuminaireSource

LUMINAIRES = ("bulbs", "dallas", "neoclassical", "star")
BASELINES = ("baked", "light")
# The reference of the brightness: among Mitsuba's integrators the one that starts rays so near to
# surfaces that thin glass emits as much as it should, see
# docs/decisions/media.md. It is noisy, and needs more time than the others: `--only`.
REFERENCE = "lumitree-path"
_COLUMNS = 4


def methods(name: str, asset: Any, room: Room, options: argparse.Namespace) -> list[Method]:
    """All methods for a lamp; prints which are left out."""
    from lumitree.lamp.luminaire import load_luminaire

    found = mitsuba_methods(name, asset, room)
    luminaire = load_luminaire(name)
    others = {
        "luxcore": lambda program: luxcore_methods(luminaire, room, find_luxcore(program)),
        "blender": lambda program: cycles_methods(luminaire, asset, room, program),
    }
    for option, make in others.items():
        program = getattr(options, option)
        try:
            if program is None:
                raise LumitreeError(f"--{option} is not given")
            found += make(program)
        except LumitreeError as error:
            print(f"{name}: methods of {option} are left out: {error}", file=sys.stderr)
    return found


def measure(name: str, options: argparse.Namespace, output: Path) -> dict[str, Any] | None:
    """Render what is missing, and the figures of all methods of a lamp; None without baselines."""
    import lumitree
    from lumitree.lamp.luminaire import load_luminaire

    folder = options.work / file_name(LuminaireSource(name))
    folder.mkdir(parents=True, exist_ok=True)
    asset_path = folder / "lamp.lumitree"
    if not asset_path.exists():
        config = lumitree.BakeConfig(parts=("light", "geometry"), irradiance_paths=0)
        lumitree.bake(name, asset_path, config, progress=None)
    luminaire, asset = load_luminaire(name), lumitree.load(asset_path)
    room = Room(options.width, flux_in_room(asset).tolist())
    key = {
        "lamp": luminaire.fingerprint,
        "asset": digest(asset_path),
        "room": dataclasses.asdict(room),
        "path_depth": PATH_DEPTH,
    }
    runs: dict[str, LongRun] = {}
    found = {method.name: method for method in methods(name, asset, room, options)}
    for method in found.values():
        run = opened_run(method, folder, key)
        if options.only is None or method.name in options.only:
            try:
                extend(run, method, options.seconds)
            except LumitreeError as error:
                print(f"{name}: {method.name} is left out: {error}", file=sys.stderr)
                continue
            print(f"{name}: {method.name}, {run.seconds['cpu']:.0f} CPU s", file=sys.stderr)
        if len(run.batches) > 1:
            runs[method.name] = run
    if any(base not in runs for base in BASELINES):
        print(f"{name}: no images of {' and '.join(BASELINES)} yet", file=sys.stderr)
        return None
    mask = shows_diffuse(asset, room.width, room.mitsuba())
    row = compare(luminaire.name, found, runs, mask)
    guides = Guides.of(placed(luminaire, room.width, room.mitsuba()))
    try:
        for each, run in runs.items():
            noise = denoised_noise(
                run, guides, mask, runs[BASELINES[0]].mean, options.image_seconds
            )
            row["methods"][each]["denoised"] = noise
    except LumitreeError as error:
        print(f"{name}: nothing is denoised: {error}", file=sys.stderr)
    row["images"] = f"rivals-{folder.name}.png"
    draw(output / row["images"], found, runs, options.image_seconds)
    return row


def compare(
    name: str, found: dict[str, Method], runs: dict[str, LongRun], mask: Any
) -> dict[str, Any]:
    """Figures of all methods of a lamp.

    Args:
        name: of the lamp.
        found: methods by name.
        runs: images by method.
        mask: [H, W] pixels that show diffuse surfaces alone.
    """
    reference = REFERENCE if REFERENCE in runs else BASELINES[0]
    clean = runs[BASELINES[0]].mean
    whole = {each: clean if found[each].whole_image else None for each in runs}
    rows = {
        each: figures(run, mask, runs[reference], whole[each], clean) for each, run in runs.items()
    }
    products = {base: rows[base].product for base in BASELINES}
    return {
        "luminaire": name,
        "reference": reference,
        "diffuse_share": float(mask.mean()),
        "resolution": list(clean.shape[1::-1]),
        "methods": {
            each: {
                "label": found[each].label,
                "lost": list(found[each].lost),
                **dataclasses.asdict(row),
                "product": row.product,
                "verdict": row.verdict,
                "over": {base: row.product / product for base, product in products.items()},
            }
            for each, row in rows.items()
        },
    }


def table(row: dict[str, Any]) -> Table:
    """A line for each method of a lamp."""
    heads = ["method", "CPU ms a sample", "variance", "product over ours", "over light field alone"]
    heads += ["mean over reference", "verdict"]
    heads += [f"CPU s to {level:g}" for level in DISPLAY_LEVELS]
    heads += ["bias", "denoised: noise", "CPU s", "samples", "CPU s of all"]
    lines = []
    for name, method in row["methods"].items():
        mean = method["mean"]
        verdict = "reference" if name == row["reference"] else method["verdict"]
        cells = [
            method["label"],
            f"{method['milliseconds']:.3g}",
            f"{method['variance']:.3g}",
            f"{method['over']['baked']:.3g}",
            f"{method['over']['light']:.3g}",
            f"{mean['value']:.3f} ± {mean['error']:.3f}",
            "; ".join([verdict, *method["lost"]]),
        ]
        cells += [time_text(each) for each in method["display"]] or ["-"] * len(DISPLAY_LEVELS)
        cells.append(bias_text(method["display_bias"]))
        noise = method.get("denoised")
        cells += (
            ["-"] * 2 if noise is None else [f"{noise['error']:.1%}", f"{noise['seconds']:.1f}"]
        )
        cells += [str(method["samples"]), f"{method['seconds']:.0f}"]
        lines.append(cells)
    return Table(heads, lines)


def draw(path: Path, found: dict[str, Method], runs: dict[str, LongRun], seconds: float) -> None:
    """The images of all methods after about equally much CPU time, as one PNG."""
    from lumitree.rendering.drawing import Panel, write_strip
    from lumitree.rendering.photograph import PhotoSettings, ev_of_white

    clean = runs[BASELINES[0]].mean
    panels = []
    for name, run in runs.items():
        cost = run.seconds["cpu"] / len(run.batches)
        count = max(1, min(len(run.batches), round(seconds / cost)))
        caption = f"{found[name].label}\n{count * run.samples} samples, {count * cost:.1f} CPU s"
        panels.append(Panel(caption, run.batches[:count].mean(0)))
    path.parent.mkdir(parents=True, exist_ok=True)
    ev = ev_of_white(float(np.median(clean)) / 0.3)
    settings = PhotoSettings(exposure=f"ev={ev}", white_balance="off", view="srgb")
    write_strip(path, panels, settings, columns=_COLUMNS)


# Notes on the renderers, for the tables.
_NOTES = """\
* The window of the room emits half the luminous flux of the lamp.
* All renderers have the same meshes, camera and longest path, no clamping and no reconstruction
  filter. Glass, diffuse surfaces and emitters are the same; rough metals are microfacets of
  Beckmann in Mitsuba, and of Trowbridge and Reitz with an approximate Fresnel reflectance in the
  others. In Mitsuba these make the light of `bulbs` 2.0 % less. LuxCore's metals reflect all light
  at grazing angles, and the metals of `little_lamp` are darker in Mitsuba: by this, or by the
  plastics, LuxCore's images of it are 5 % brighter.
* Mitsuba's `path` and `ptracer` start rays so far from surfaces that thin glass emits too much.
* Russian roulette of LuxCore's BIDIRCPU is biased; late roulette starts at a depth of 12. Its
  Markov chains (Metropolis) start anew in each image of a few samples, which darkens.
* LuxCore's media that scatter let no light out of `star`, so that its methods are left out there;
  Cycles has none, so that its opal glass is clear.
* Path guiding of Cycles learns anew in each image of 32 samples.
* Far field and point lights are small cells of a light field, which `lumitree_path` samples.
* Variances above 100 come from rare bright samples, and are known to about a factor of 1.5.

"""


def report(rows: list[dict[str, Any]], facts: dict[str, Any]) -> str:
    """Text of the Markdown file."""
    text = "# Rivals\n\n"
    text += "Product: CPU time of a sample times its relative variance on diffuse surfaces. "
    text += f"Verdict: whether the mean of these is within {TOLERANCE:.0%} of the reference. "
    text += "CPU s: of a whole image to an `rmse_display` by noise alone; ~ is extrapolated by "
    text += "the variance, and < is a bound from the cheapest image. Bias: the `rmse_display` of a "
    text += "whole image without noise, against the reference without noise; < is a bound where it "
    text += "is within two standard errors of none. Denoised: relative RMS error "
    text += "by noise on diffuse surfaces of images that cost as many CPU s as stated.\n\n"
    for row in rows:
        text += f"## {row['luminaire']}\n\n{table(row).markdown()}\n"
        text += f"![Images at equal time]({row['images']})\n\n"
    return text + _NOTES + notes(facts)


def add_options(parser: argparse.ArgumentParser) -> None:
    parser.add_argument("luminaires", metavar="LUMINAIRE", nargs="*", default=list(LUMINAIRES))
    parser.add_argument("--work", metavar="FOLDER", type=Path, default=Path("rivals.work"))
    parser.add_argument("--luxcore", metavar="PYTHON", help="with the module pyluxcore")
    parser.add_argument("--blender", metavar="PROGRAM", help="Blender, or a Python with bpy")
    parser.add_argument("--only", metavar="METHOD", nargs="+", help="to render; others as they are")
    parser.add_argument("--seconds", type=float, default=40, help="CPU seconds of a method")
    parser.add_argument(
        "--image-seconds",
        type=float,
        default=5,
        help="CPU seconds of images that are shown, and denoised",
    )
    parser.add_argument("--width", type=int, default=160, help="of images, pixels")


def run(options: argparse.Namespace) -> None:
    results = Results(
        options,
        width=options.width,
        path_depth=PATH_DEPTH,
        clock="cpu",
        baseline="baked lamp",
    )
    known = {row["luminaire"]: row for row in results.stored({"luminaires": []})["luminaires"]}
    for name in options.luminaires:
        row = measure(name, options, results.folder)
        if row is None:
            continue
        print(table(row).text(), flush=True)
        known[row["luminaire"]] = row
        facts, rows = results.setting(), list(known.values())
        results.write({"setting": facts, "luminaires": rows}, report(rows, facts))
