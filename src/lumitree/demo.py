"""The demonstration: bake the built-in lamp, hang it in a room, and compare with the real one."""

from pathlib import Path

import numpy as np
from numpy.typing import NDArray

from lumitree import pipeline
from lumitree.core.backend import load_mitsuba
from lumitree.core.files import write_json
from lumitree.core.images import write_exr

LUMINAIRE = "bulbs"
BAKE_SECONDS = 150
WIDTH = 256
SAMPLES, REFERENCE_SAMPLES = 64, 512


def run(folder: str = "demo-output", variant: str | None = None) -> pipeline.Report:
    """Bake, evaluate and render; writes pictures, the asset and `report.json` into `folder`."""
    output = Path(folder)
    asset = str(output / "lamp.lumitree")
    baked = pipeline.bake(LUMINAIRE, asset, seconds=BAKE_SECONDS, variant=variant)
    evaluation = pipeline.evaluate(
        asset,
        LUMINAIRE,
        sheet=str(output / "evaluation.png"),
        num_views=5,
        resolution=192,
        samples_per_pixel=128,
    )
    watch = pipeline.Stopwatch()
    errors = _render_room(output, asset, watch)
    seconds = baked["seconds"] | evaluation["seconds"] | watch.seconds
    report = {
        "evaluate": evaluation,
        "room": errors,
        "seconds": seconds | {"total": round(sum(seconds.values()), 3)},
        "peak_memory_bytes": pipeline.peak_memory_bytes(),
    }
    write_json(output / "report.json", report)
    files = sorted(str(path) for path in output.iterdir())
    return report | {"files": files}


def _render_room(output: Path, asset: str, watch: pipeline.Stopwatch) -> pipeline.Report:
    """Render the room three times and write the pictures; returns errors against the reference."""
    load_mitsuba()
    from lumitree.evaluation.metrics import rel_mse
    from lumitree.evaluation.strip import write_strip
    from lumitree.rendering.demo_room import demo_room, lamp
    from lumitree.rendering.scene import default_integrator, furnish, render

    integrator = default_integrator(12)
    jobs = {
        "baked": (asset, SAMPLES, 0),
        "explicit": (LUMINAIRE, SAMPLES, 0),
        "reference": (LUMINAIRE, REFERENCE_SAMPLES, 1),
    }
    images: dict[str, NDArray[np.float32]] = {}
    for name, (source, samples, seed) in jobs.items():
        scene = furnish(demo_room(WIDTH), [lamp(source)])
        with watch.stage(f"room {name}"):
            images[name] = render(scene, integrator, samples, seed=seed, name=f"room, {name}")
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
