"""The demonstration: bake the built-in lamp, hang it in a room, and compare with the real one."""

from pathlib import Path
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.api.baking import bake
from lumitree.api.measures import Stopwatch, peak_memory_bytes
from lumitree.api.viewing import evaluate
from lumitree.core.backend import load_mitsuba
from lumitree.core.files import write_json
from lumitree.core.images import write_exr
from lumitree.core.interrupt import Interrupted

LUMINAIRE = "bulbs"
BAKE_SECONDS = 150
WIDTH = 256
SAMPLES, REFERENCE_SAMPLES = 64, 512


def run(folder: str = "demo-output", variant: str | None = None) -> dict[str, Any]:
    """Bake, evaluate and render; writes images, the asset and `report.json` into `folder`."""
    output = Path(folder)
    asset = output / "lamp.lumitree"
    baked = bake(LUMINAIRE, asset, time=BAKE_SECONDS, variant=variant)
    if baked.stopped_by is not None:
        raise Interrupted("the same command continues", baked.stopped_by)
    evaluation = evaluate(
        asset,
        LUMINAIRE,
        output / "evaluation.png",
        num_views=5,
        resolution=192,
        samples_per_pixel=128,
    )
    watch = Stopwatch()
    errors = _render_room(output, str(asset), watch)
    seconds = baked.seconds | evaluation.seconds | watch.seconds
    report = {
        "evaluate": evaluation.to_json(),
        "room": errors,
        "seconds": seconds | {"total": round(sum(seconds.values()), 3)},
        "peak_memory_bytes": peak_memory_bytes(),
    }
    write_json(output / "report.json", report)
    files = sorted(str(path) for path in output.iterdir())
    return report | {"files": files}


def _render_room(output: Path, asset: str, watch: Stopwatch) -> dict[str, Any]:
    """Render the room three times and write the pictures; returns errors against the reference."""
    load_mitsuba()
    from lumitree.evaluation.metrics import rel_mse
    from lumitree.evaluation.strip import write_strip
    from lumitree.rendering.demo_room import demo_room, lamp
    from lumitree.rendering.scene import (
        PlacedLuminaire,
        default_integrator,
        place_luminaires,
        render_scene,
    )

    integrator = default_integrator(12)
    jobs = {
        "baked": (asset, SAMPLES, 0),
        "explicit": (LUMINAIRE, SAMPLES, 0),
        "reference": (LUMINAIRE, REFERENCE_SAMPLES, 1),
    }
    images: dict[str, NDArray[np.float32]] = {}
    for name, (source, samples, seed) in jobs.items():
        scene = place_luminaires(demo_room(WIDTH), [PlacedLuminaire(lamp(source))])
        with watch.stage(f"room {name}"):
            images[name] = render_scene(scene, integrator, samples, seed=seed, name=f"room, {name}")
        write_exr(output / f"room-{name}.exr", {"RGB": images[name]})
    reference = images["reference"]
    errors = {name: float(rel_mse(images[name], reference)) for name in ("baked", "explicit")}
    captions = {
        name: f"{name} lamp, {samples} samples a pixel\n{watch.seconds[f'room {name}']:.0f} s"
        + (f", relMSE {errors[name]:.3f}" if name in errors else "")
        for name, (_, samples, _) in jobs.items()
    }
    captions["reference"] = captions["reference"].replace("reference", "reference: explicit")
    write_strip(
        output / "comparison.png",
        [(captions[name], images[name]) for name in images],
        # The room well below middle grey, so that window and lamp keep their detail.
        0.07 / float(np.median(reference)),
    )
    return {"rel_mse": errors}
