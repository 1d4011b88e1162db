"""The demonstration: bakes a built-in lamp and compares it with the explicit lamp in a room."""

import dataclasses
import sys
from pathlib import Path

from lumitree.asset.asset import PARTS
from lumitree.core.backend import load_rgb
from lumitree.core.files import FilePath, write_json
from lumitree.core.images import image_settings
from lumitree.core.interruption import Interrupted
from lumitree.core.results import Json, peak_memory_bytes
from lumitree.errors import LumitreeError
from lumitree.fit.bake import bake
from lumitree.fit.config import BakeConfig
from lumitree.measure.evaluate import IRRADIANCE_PATHS, evaluate
from lumitree.rendering.photograph import PhotoSettings
from lumitree.rendering.render import RenderResult, render

LUMINAIRE = "bulbs"
# Budget of the radiance field of the full demonstration.
BAKE_SECONDS = 150
WIDTH = 640
# Time of rendering of each image, and in the full demonstration.
ROOM_SECONDS, FULL_ROOM_SECONDS = 16.0, 60.0
# Fewer samples per pixel are explained.
_FEW_SAMPLES = 8


def demo(
    output: FilePath = "demo-output",
    *,
    full: bool = False,
    variant: str | None = None,
    settings: PhotoSettings | None = None,
) -> Json:
    """Bake a built-in lamp, and compare it with the explicit lamp in a room.

    Args:
        output: folder for the images, the report `report.json` and the asset.
        full: make a radiance field too, and compare its views: 6 minutes on 2 CPU cores, not 1.
        variant: Mitsuba variant; see `bake`.
        settings: of the photographs of the room. Default: automatic.
    """
    folder = Path(output)
    asset = folder / "lamp.lumitree"
    config = BakeConfig.of()
    if full:
        # `evaluate` compares the irradiance.
        octree = dataclasses.replace(config.octree, time=BAKE_SECONDS)
        config = BakeConfig(parts=PARTS, octree=octree, irradiance_paths=0)
    baked = bake(LUMINAIRE, asset, config, variant=variant)
    if baked.stopped_by is not None:
        raise Interrupted("the same command continues", baked.stopped_by)
    seconds, report = baked.seconds, {"bake": baked.to_json()}
    if full:
        evaluation = evaluate(
            asset,
            LUMINAIRE,
            folder / "evaluation.png",
            views=5,
            resolution=192,
            spp=128,
            irradiance_paths=IRRADIANCE_PATHS,
        )
        seconds, report = seconds | evaluation.seconds, {"evaluate": evaluation.to_json()}
    budget = FULL_ROOM_SECONDS if full else ROOM_SECONDS
    room = _render_room(folder, str(asset), budget, settings or PhotoSettings())
    for name, image in room.items():
        seconds = seconds | {f"room {name}, {stage}": s for stage, s in image.seconds.items()}
    report |= {
        "room": {name: image.to_json() for name, image in room.items()},
        "seconds": seconds | {"total": round(sum(seconds.values()), 3)},
        "peak_memory_bytes": peak_memory_bytes(),
    }
    write_json(folder / "report.json", report)
    files = sorted(str(path) for path in folder.iterdir())
    return report | {"files": files}


def _render_room(
    folder: Path, asset: str, seconds: float, settings: PhotoSettings
) -> dict[str, RenderResult]:
    """Render the room with both lamps in equal time, and write the images."""
    load_rgb()
    from lumitree.rendering.demo_room import demo_room, lamp
    from lumitree.rendering.drawing import Panel, write_strip
    from lumitree.rendering.layers import check_denoiser

    try:
        check_denoiser()
        filters = True
    except LumitreeError:
        print(
            "note: the images are not denoised; for that, `pip install 'lumitree[denoise]'`, and "
            "run the same command again",
            file=sys.stderr,
        )
        filters = False
    found = {
        name: render(
            demo_room(WIDTH, ball_in_box=True),
            [lamp(source)],
            time=seconds,
            denoise=filters,
            aov=True,
        )
        for name, source in (("baked", asset), ("explicit", LUMINAIRE))
    }
    if (least := min(image.spp for image in found.values())) < _FEW_SAMPLES:
        print(
            f"note: the computer was busy: {least} samples per pixel in {seconds:g} s; on an idle "
            "one the images are better",
            file=sys.stderr,
        )
    images: list[Panel] = []
    for name, image in found.items():
        assert image.noisy is not None
        noise = "" if image.noise is None else f", noise {image.noise:.0%}"
        took = f"{name} lamp, {image.seconds['render']:.0f} s"
        title = f"{took}\n{image.spp} samples per pixel{noise}"
        images.append(Panel(title, image.noisy, image.highlights))
        image.save(folder / f"room-{name}.exr")
    if filters:
        images += [
            Panel(f"{name} lamp, denoised", image.pixels, image.highlights)
            for name, image in found.items()
        ]
    write_strip(
        folder / "comparison.png",
        images,
        settings,
        image_settings("demo", lamps=list(found), time=seconds, width=WIDTH),
        columns=2,
    )
    return found
