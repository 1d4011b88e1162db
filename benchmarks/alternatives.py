"""Error of a room's light at equal time, by what people use for a lamp.

    python -m benchmarks alternatives [--seconds 10 60] [--data FOLDER] [LUMINAIRE ...]

Each luminaire hangs in the demonstration's room as: explicit geometry; explicit geometry with thin
glass in place of all smooth glass, so that shadow rays cross it; the far field of an IES file,
emitted evenly from the lamp's box; an emissive sphere of the same flux; an asset with a
light field; and, where mitsuba-oidn is installed, explicit geometry and asset denoised. The
reference is a long run of explicit geometry. Compared are the pixels that show diffuse surfaces of
the room.

Bias is the difference of the long runs, relative to the reference, with the noise of both
subtracted (RMS). The error after a time is √(bias² + variance × seconds of a sample / time), for
times of the CPU; that of denoised images is measured, with the noise of the reference subtracted.
The explicit lamp is the baseline of the last column, the ratio of errors at the last of the times.
Writes `alternatives.md`, `alternatives.json`, and a sheet of crops of each lamp.
"""

import argparse
import importlib.util
import math
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

from benchmarks.common.demo_lamps import flux_in_room, placed, shows_diffuse, sphere_room
from benchmarks.common.lamps import add_luminaires, file_name, sources
from benchmarks.common.options import add_pixels, add_seed
from benchmarks.common.results import Results, notes
from benchmarks.common.tables import Table
from benchmarks.common.timing import Job, interleaved
from benchmarks.equal_error.error_against_time import (
    noise,
    relative_weights,
    squared_difference,
    trimming,
)
from lumitree.core.files import atomic_path
from lumitree.core.images import tonemap
from lumitree.lamp.source import LuminaireSource

# Of 8 bounces glass takes so many that the explicit lamp would be up to 11 % too dark.
PATH_DEPTH = 64
BASELINE = "explicit"
# Of the long runs: at least so many batches, of `--spp` samples a pixel each.
BATCHES = 8
# What is denoised, by name of the result.
DENOISED = {"explicit, denoised": BASELINE, "baked, denoised": "baked"}
# Part of the image that the sheet shows: below and beside the lamp.
CROP = np.s_[0.55:0.95, 0.1:0.6]


def scenes_of(
    source: LuminaireSource, asset: Any, folder: Path, options: argparse.Namespace
) -> dict[str, Any]:
    """Scenes by method; the IES file is made in a folder."""
    import lumitree

    lumitree.photometry(source, folder / "far_field.ies", seed=options.seed)
    far_field = lumitree.bake_photometric(folder / "far_field.ies").asset
    return {
        BASELINE: placed(source, options.width),
        "thin glass": thin_glass_room(source, options.width),
        "IES": with_flux_of(asset, far_field, options.width),
        "sphere": sphere_room(asset, options.width),
        "baked": placed(asset, options.width),
    }


def with_flux_of(asset: Any, other: Any, width: int) -> Any:
    """The room with another asset, of the size and the flux of the first."""
    from lumitree.rendering.demo_room import LAMP_CENTRE, LAMP_SIZE, demo_room
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, place_luminaires

    gain = flux_in_room(asset).sum() / flux_in_room(other).sum()
    lamp = Placement(other, at=LAMP_CENTRE, size=LAMP_SIZE, gain=float(gain))
    return place_luminaires(demo_room(width), [PlacedLuminaire(lamp)])


def thin_glass_room(source: LuminaireSource, width: int) -> Any:
    """The room with explicit geometry whose smooth glass bends no ray."""
    import mitsuba as mi

    from lumitree.lamp.opening import open_scene_file
    from lumitree.rendering.demo_room import LAMP_CENTRE, LAMP_SIZE, demo_room
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire

    place = PlacedLuminaire(Placement(source, at=LAMP_CENTRE, size=LAMP_SIZE)).scene_from_world
    file = open_scene_file(source)
    for node in file.nodes("BSDF"):
        if node.props.plugin_name() == "dielectric":
            node.props.set_plugin_name("thindielectric")
    for node in file.nodes("Shape"):
        own = node.props.get("to_world", mi.ScalarTransform4d())
        node.props["to_world"] = mi.ScalarTransform4d(place @ np.array(own.matrix))
    room = demo_room(width)
    shapes = [*room.shapes(), *file.instantiate().shapes()]
    objects: dict[str, Any] = {f"shape_{i}": shape for i, shape in enumerate(shapes)}
    return mi.load_dict({"type": "scene", "sensor": room.sensors()[0], **objects})


def measure(source: LuminaireSource, name: str, options: argparse.Namespace) -> dict:
    """A row, and the sheet."""
    import lumitree

    asset = lumitree.bake(
        source,
        config=lumitree.BakeConfig(parts=("light",), irradiance_paths=0, seed=options.seed),
    ).asset
    with tempfile.TemporaryDirectory() as folder:
        scenes = scenes_of(source, asset, Path(folder), options)
    mask = shows_diffuse(asset, options.width)[..., None]
    batches: dict[str, list[Any]] = {each: [] for each in scenes}
    times = interleaved(
        {each: _job(each, scenes[each], batches[each], options) for each in scenes},
        BATCHES,
        clock="cpu",
    )
    seconds = {each: times[each] / options.spp for each in scenes}
    extend(scenes[BASELINE], batches[BASELINE], times[BASELINE], options)
    images = {each: np.array(values, np.float64) for each, values in batches.items()}
    reference = images[BASELINE].mean(axis=0)
    # Both halves of the baseline are independent, so that its own bias is known to be 0.
    variance = {e: v.var(axis=0, ddof=1) for e, v in images.items()}
    weights = relative_weights(reference) * mask
    weights = weights * trimming(*(v * weights for v in variance.values())) / mask.mean()
    methods = {}
    for each, values in images.items():
        square = noise(values, weights) * (len(values) * options.spp)
        bias = squared_difference(values, images[BASELINE], weights)
        found = 0.0 if each == BASELINE else max(bias.value, 0.0)
        methods[each] = {
            "seconds_per_sample": seconds[each],
            "variance": square.value,
            "bias": math.sqrt(found),
            "bias_mse_error": None if each == BASELINE else bias.error,
            "mean_ratio": float((values.mean(0) * mask).sum() / (reference * mask).sum()),
            "error": [
                math.sqrt(found + square.value * seconds[each] / time) for time in options.seconds
            ],
        }
    own = noise(images[BASELINE], weights)
    for each, of in DENOISED.items() if _denoiser_is_there() else ():
        methods[each] = {
            "seconds_per_sample": seconds[of],
            "error": [
                _error_denoised(scenes[of], time / seconds[of], reference, weights, own, options)
                for time in options.seconds
            ],
        }
    sheet = draw(name, scenes, seconds, reference, options)
    return {
        "luminaire": name,
        "methods": methods,
        "reference_error": math.sqrt(own.value),
        "reference_spp": len(images[BASELINE]) * options.spp,
        "sheet": sheet,
    }


def _job(name: str, scene: Any, images: list[Any], options: argparse.Namespace) -> Job:
    def take(index: int) -> None:
        images.append(_image(scene, options.spp, options.seed + index))

    return lambda index: lambda: take(index)


def _image(scene: Any, samples: int, seed: int) -> Any:
    import mitsuba as mi

    from lumitree.rendering.passes import Budget, render_passes

    integrator = mi.load_dict({"type": "lumitree_path", "max_depth": PATH_DEPTH})
    return render_passes(scene, integrator, Budget(samples), seed=seed).radiance


def _denoiser_is_there() -> bool:
    return importlib.util.find_spec("mitsuba_oidn") is not None


def _denoised(scene: Any, samples: float, seed: int) -> Any:
    """A denoised image [H, W, 3]; filtering takes 0.3 s, which do not count."""
    import mitsuba as mi

    from lumitree.rendering.denoise import denoised
    from lumitree.rendering.layers import Layers
    from lumitree.rendering.passes import Budget, render_passes

    integrator: Any = mi.load_dict({"type": "lumitree_path", "max_depth": PATH_DEPTH})
    integrator.layers = Layers(scene)
    budget = Budget(max(1, round(samples)))
    channels = render_passes(scene, integrator, budget, seed=seed).channels
    recorded = denoised(integrator.layers.divide(channels[..., 3:]))
    return (recorded.seen + recorded.lit).sum(axis=0)


def _error_denoised(
    scene: Any, samples: float, reference: Any, weights: Any, own: Any, options: argparse.Namespace
) -> float:
    """Relative error of a denoised image."""
    image = _denoised(scene, samples, options.seed + 2000)
    square = float(((image - reference) ** 2 * weights).mean()) - own.value
    return math.sqrt(max(square, 0.0))


def extend(scene: Any, images: list[Any], seconds: float, options: argparse.Namespace) -> None:
    """Add batches to the reference until its time is spent."""
    count = max(len(images), math.ceil(options.reference / seconds))
    for index in range(len(images), count):
        images.append(_image(scene, options.spp, options.seed + index))


def draw(
    name: str,
    scenes: dict[str, Any],
    seconds: dict[str, float],
    reference: Any,
    options: argparse.Namespace,
) -> str:
    """Crops after the first of the times, and of the reference."""
    height, width = reference.shape[:2]
    rows, columns = (
        slice(int(part.start * size), int(part.stop * size))
        for part, size in zip(CROP, (height, width), strict=True)
    )
    exposure = 0.18 / float(np.median(reference.mean(axis=-1)))
    tiles = [("reference", reference)]
    for each, scene in scenes.items():
        samples = max(1, round(options.seconds[0] / seconds[each]))
        tiles.append((f"{each}, {samples} spp", _image(scene, samples, options.seed + 1000)))
    for each, of in DENOISED.items() if _denoiser_is_there() else ():
        samples = max(1, round(options.seconds[0] / seconds[of]))
        tiles.append((f"{each}, {samples} spp", _denoised(scenes[of], samples, options.seed)))
    columns_of_sheet = (len(tiles) + 1) // 2
    figure = Figure(figsize=(3.4 * columns_of_sheet, 5.8), layout="constrained")
    axes = figure.subplots(2, columns_of_sheet).ravel()
    for axis in axes[len(tiles) :]:
        axis.set_axis_off()
    for (title, image), axis in zip(tiles, axes, strict=False):
        axis.imshow(tonemap(image[rows, columns], exposure), interpolation="nearest")
        axis.set_title(title, fontsize=10)
        axis.set_axis_off()
    figure.suptitle(f"{name}, {options.seconds[0]:g} CPU seconds each", fontsize=11)
    FigureCanvasAgg(figure)
    path = Path(options.output) / "alternatives" / f"{name}.jpg"
    path.parent.mkdir(parents=True, exist_ok=True)
    with atomic_path(path) as temporary:
        figure.savefig(temporary, dpi=80, format="jpeg", pil_kwargs={"quality": 85})
    return f"alternatives/{name}.jpg"


def table(rows: list[dict], times: list[float]) -> Table:
    """A line for each luminaire and method."""
    heads = ["luminaire", "method", "ms a sample", "variance", "mean", "bias"]
    heads += [*(f"error after {time:g} s" for time in times), "explicit / this"]
    lines = []
    for row in rows:
        explicit = row["methods"][BASELINE]["error"][-1]
        for name, found in row["methods"].items():
            lines.append(
                [
                    row["luminaire"],
                    name,
                    f"{1000 * found['seconds_per_sample']:.0f}",
                    f"{found['variance']:.3g}" if "variance" in found else "-",
                    f"{found['mean_ratio']:.3f}" if "mean_ratio" in found else "-",
                    f"{found['bias']:.1%}" if "bias" in found else "-",
                    *(f"{error:.1%}" for error in found["error"]),
                    f"{explicit / found['error'][-1]:.2f}",
                ]
            )
    return Table(heads, lines, left=2)


def add_options(parser: argparse.ArgumentParser) -> None:
    add_luminaires(parser)
    parser.add_argument(
        "--seconds", type=float, nargs="+", default=[10.0, 60.0], help="CPU times to compare at"
    )
    parser.add_argument(
        "--reference", type=float, default=120.0, help="CPU seconds of the reference"
    )
    add_pixels(parser, "--width", 320, 16)
    add_seed(parser)


def run(options: argparse.Namespace) -> None:
    results = Results(options, path_depth=PATH_DEPTH, baseline=BASELINE, clock="cpu")
    rows: list[dict] = []
    for source, _ in sources(options.luminaires, options.data):
        name = file_name(source)
        rows.append(measure(source, name, options))
        # After every row: all of them take minutes.
        facts = results.setting()
        text = f"# Alternatives\n\n{table(rows, options.seconds).markdown()}\n{notes(facts)}"
        results.write({"setting": facts, "luminaires": rows}, text)
        print(f"measured {name}", file=sys.stderr)
    print(table(rows, options.seconds).text())
