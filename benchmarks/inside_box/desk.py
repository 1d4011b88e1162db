"""A desk scene with objects inside a lamp's box: explicit and baked lamp at equal time.

The reference is the explicit lamp. Path tracing would take days for it, since it finds the light of
a bulb by chance: so where only rough surfaces are seen, it is Mitsuba's light tracer
(`ptracer`), of the same longest path. Light tracing cannot show smooth ones, and there the
reference is a long run of path tracing.
"""

from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.common.timing import MIN_ROUNDS, Job, interleaved
from benchmarks.equal_error.batches import LongRun, digest
from benchmarks.equal_error.error_against_time import display_rmse
from lumitree.lamp.source import LuminaireSource

# Independent images of each lamp.
IMAGES = 3
# Samples a pixel of an image that is timed.
_TIMED_SAMPLES = 4
# Of scenes that name no integrator.
_PATH_DEPTH = 16
# Of a batch of the light tracer, and its part of the time of the reference.
_LIGHT_SAMPLES, _LIGHT_SHARE = 32, 0.8
# Rays of a pixel, a side, that tell whether it shows rough surfaces alone.
_STRATA = 4


def desk(
    scene: Path,
    source: LuminaireSource,
    asset: Any,
    references: Path,
    picture: Path,
    *,
    seconds: float,
    reference_seconds: float,
    seed: int,
) -> dict[str, Any]:
    """Errors of both lamps, and a file with their images side by side.

    Args:
        scene: a scene file with a camera; the lamps are placed where their own file has them.
        source: the explicit lamp.
        asset: the baked lamp.
        references: folder of the long explicit runs, which are continued if they are there.
        picture: PNG file to write.
        seconds: CPU time of an image.
        reference_seconds: wall time that is added to the long runs.
        seed: of all random numbers.

    Returns:
        For each lamp the samples per pixel, the seconds of one, and `rmse_display` (see
        `display_rmse`) against the reference, as the mean over independent images; and that of the
        reference by its own noise.
    """
    from lumitree.core.drawing import write_strip
    from lumitree.core.photometry import LUMENS_PER_WATT, luminance

    lamps = {"explicit": source, "baked": asset}
    scenes = {name: _scene(scene, lamp) for name, lamp in lamps.items()}

    def job(name: str) -> Job:
        return lambda index: lambda: _image(*scenes[name], _TIMED_SAMPLES, seed + index)

    times = interleaved({name: job(name) for name in scenes}, MIN_ROUNDS, clock="cpu")
    reference, facts = _reference(
        scenes["explicit"], references, digest(scene, Path(source.name)), reference_seconds, seed
    )
    row: dict[str, Any] = {
        "scene": scene.stem,
        "luminaire": asset.luminaire,
        "cpu_seconds": seconds,
        "reference": facts,
        "lamps": {},
    }
    panels = []
    for name in scenes:
        samples = max(1, round(seconds * _TIMED_SAMPLES / times[name]))
        images = np.array(
            [_image(*scenes[name], samples, seed + 1000 + number) for number in range(IMAGES)]
        )
        error = float(display_rmse(images, reference).mean())
        row["lamps"][name] = {
            "samples": samples,
            "seconds_per_sample": times[name] / _TIMED_SAMPLES,
            "rmse_display": error,
            "mean_over_reference": float(images.mean() / reference.mean()),
        }
        caption = f"{name} lamp, {samples} samples per pixel\n{seconds:.0f} s of CPU time"
        panels.append((f"{caption}, rmse_display {error:.1f}", images[0]))
    panels.append(("explicit lamp, reference\n(light tracing)", reference))
    seen = luminance(reference)
    # The exposure of `display_rmse`.
    exposure = 0.18 * LUMENS_PER_WATT / float(np.median(seen[seen > 0]))
    write_strip(picture, panels, exposure)
    return row


def _reference(
    scene: tuple[Any, Any], folder: Path, key: str, seconds: float, seed: int
) -> tuple[Any, dict[str, Any]]:
    """The reference [H, W, 3], and what is known of it."""
    import mitsuba as mi

    # Emitters are hidden since no pixel that shows one is taken from it.
    depths = {"max_depth": _PATH_DEPTH, "rr_depth": _PATH_DEPTH}
    tracer = mi.load_dict({"type": "ptracer", "hide_emitters": True, **depths})

    def light(samples: int, number: int) -> Any:
        image = mi.render(scene[0], integrator=tracer, spp=samples, seed=seed + number)
        return np.array(image)[..., :3]

    folder.mkdir(parents=True, exist_ok=True)
    lights = LongRun(folder / f"desk-light-{key}.npz", "light", first_samples=_LIGHT_SAMPLES)
    lights.extend(light, _LIGHT_SHARE * seconds)
    paths = LongRun(folder / f"desk-paths-{key}.npz", "paths", first_samples=_TIMED_SAMPLES)
    paths.extend(
        lambda samples, number: _image(*scene, samples, seed + number),
        (1 - _LIGHT_SHARE) * seconds,
    )
    rough = _shows_rough(scene[0])[..., None]
    halves = [
        np.where(rough, lights.batches[part::2].mean(0), paths.batches[part::2].mean(0))
        for part in (0, 1)
    ]
    facts = {
        # A half has twice the variance, and the difference of two halves four times.
        "rmse_display": float(display_rmse(halves[0][None], halves[1])[0] / 2),
        "light_spp": lights.samples_per_pixel,
        "paths_spp": paths.samples_per_pixel,
        "rough_share": float(rough.mean()),
        "paths_over_light": float(
            np.where(rough, paths.mean, 0).sum() / np.where(rough, lights.mean, 0).sum()
        ),
    }
    return np.where(rough, lights.mean, paths.mean), facts


def _shows_rough(scene: Any) -> Any:
    """Mask [H, W] of the pixels in which neither emitters nor smooth surfaces are seen."""
    import mitsuba as mi

    from lumitree.core.device import on_device

    sensor = scene.sensors()[0]
    width, height = sensor.film().size()
    steps = [(np.arange(_STRATA * n) + 0.5) / (_STRATA * n) for n in (height, width)]
    y, x = np.meshgrid(*steps, indexing="ij")
    position = on_device(mi.Point2f, np.stack([x.ravel(), y.ravel()], axis=1))
    ray, _ = sensor.sample_ray(0, 0.5, position, mi.Point2f(0.5))
    si = scene.ray_intersect(ray)
    smooth = mi.has_flag(si.bsdf().flags(), mi.BSDFFlags.Delta) | si.shape.is_emitter()
    smooth = np.array(smooth & si.is_valid()).reshape(height, _STRATA, width, _STRATA)
    return ~smooth.any(axis=(1, 3))


def _scene(path: Path, lamp: Any) -> tuple[Any, Any]:
    """Scene with a lamp in it, and its integrator."""
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import (
        appearance_for,
        load_scene,
        open_placements,
        place_luminaires,
    )

    placed = open_placements([Placement(lamp)])
    loaded, integrator = load_scene(str(path), placed)
    return place_luminaires(loaded, placed, appearance=appearance_for(integrator)), integrator


def _image(scene: Any, integrator: Any, samples: int, seed: int) -> Any:
    """An independent image [H, W, 3]."""
    from lumitree.rendering.passes import Budget, render_passes

    return render_passes(scene, integrator, Budget(samples), seed=seed, name="desk").radiance
