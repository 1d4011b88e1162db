"""The demonstration: bakes a built-in lamp and compares it with the explicit lamp in a room."""

import dataclasses
from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import PARTS
from lumitree.core.backend import load_mitsuba
from lumitree.core.files import write_json
from lumitree.core.image_settings import image_settings
from lumitree.core.images import write_exr
from lumitree.core.interrupt import Interrupted
from lumitree.core.stopwatch import Stopwatch, peak_memory_bytes
from lumitree.fit.bake import bake
from lumitree.fit.config import BakeConfig
from lumitree.measure.evaluate import IRRADIANCE_PATHS, evaluate

LUMINAIRE = "bulbs"
# Budget of the radiance field of the full demonstration.
BAKE_SECONDS = 150
WIDTH = 480
# Samples a pixel of the baked lamp, and in the full demonstration.
SAMPLES, FULL_SAMPLES = 64, 128
# Samples of the explicit lamp that tell how long one takes.
PILOT_SAMPLES = 16


def run(
    folder: str = "demo-output", variant: str | None = None, full: bool = False
) -> dict[str, Any]:
    """Bake and render; writes images, the asset and `report.json` into `folder`.

    Args:
        full: make a radiance field too, and compare the views of it with those of the lamp.
    """
    output = Path(folder)
    asset = output / "lamp.lumitree"
    config = BakeConfig.standard()
    if full:
        # `evaluate` compares the irradiance.
        config = dataclasses.replace(config, parts=PARTS, time=BAKE_SECONDS, irradiance_paths=0)
    baked = bake(LUMINAIRE, asset, config, variant=variant)
    if baked.stopped_by is not None:
        raise Interrupted("the same command continues", baked.stopped_by)
    seconds, report = baked.seconds, {"bake": baked.to_json()}
    if full:
        evaluation = evaluate(
            asset,
            LUMINAIRE,
            output / "evaluation.png",
            num_views=5,
            resolution=192,
            samples_per_pixel=128,
            irradiance_paths=IRRADIANCE_PATHS,
        )
        seconds, report = seconds | evaluation.seconds, {"evaluate": evaluation.to_json()}
    watch = Stopwatch()
    room = _render_room(output, str(asset), FULL_SAMPLES if full else SAMPLES, watch)
    seconds = seconds | watch.seconds
    report |= {
        "room": room,
        "seconds": seconds | {"total": round(sum(seconds.values()), 3)},
        "peak_memory_bytes": peak_memory_bytes(),
    }
    write_json(output / "report.json", report)
    files = sorted(str(path) for path in output.iterdir())
    return report | {"files": files}


def _render_room(output: Path, asset: str, baked_samples: int, watch: Stopwatch) -> dict[str, Any]:
    """Render the room with both lamps in equal time, and write the images.

    Returns:
        By lamp, the samples per pixel and the noise: the relative variance of a pixel, by the
        difference of two halves of the samples.
    """
    load_mitsuba()
    from lumitree.measure.metrics import rel_mse
    from lumitree.output.strip import write_strip
    from lumitree.rendering.demo_room import demo_room, lamp
    from lumitree.rendering.integrators import default_integrator
    from lumitree.rendering.passes import Budget, render_passes
    from lumitree.rendering.scene import PlacedLuminaire, appearance_for, place_luminaires

    integrator = default_integrator(12)
    images: dict[str, NDArray[np.float32]] = {}
    report: dict[str, Any] = {}
    for name, source in (("baked", asset), ("explicit", LUMINAIRE)):
        scene = place_luminaires(
            demo_room(WIDTH, ball_in_box=True),
            [PlacedLuminaire(lamp(source))],
            appearance=appearance_for(integrator),
        )
        samples = baked_samples
        if name == "explicit":
            # Twice, because the first compiles the kernels.
            for stage in ("compile", "pilot"):
                with watch.stage(stage):
                    render_passes(
                        scene, integrator, Budget(PILOT_SAMPLES), seed=2, name="room, pilot"
                    )
            rate = PILOT_SAMPLES / watch.seconds["pilot"]
            samples = max(2, round(watch.seconds["room baked"] * rate))
        half = samples // 2
        with watch.stage(f"room {name}"):
            first, second = (
                render_passes(
                    scene, integrator, Budget(half), seed=seed, name=f"room, {name} lamp"
                ).radiance
                for seed in (0, 1)
            )
        images[name] = (first + second) / np.float32(2)
        settings = image_settings("demo", lamp=name, samples_per_pixel=2 * half, width=WIDTH)
        write_exr(output / f"room-{name}.exr", {"RGB": images[name]}, settings)
        report[name] = {"samples": 2 * half, "noise": float(rel_mse(first, images[name]))}
    captions = {
        name: f"{name} lamp, {values['samples']} samples per pixel\n"
        f"{watch.seconds[f'room {name}']:.0f} s, noise (relMSE) {values['noise']:.3f}"
        for name, values in report.items()
    }
    write_strip(
        output / "comparison.png",
        [(captions[name], images[name]) for name in images],
        # The median of the room is well below middle grey, so that window and lamp are not clipped.
        0.07 / float(np.median(images["baked"])),
        image_settings("demo", lamps=report, width=WIDTH),
    )
    return report
