"""One denoised image of a room at night by one method, in a process whose time is measured.

`python -m benchmarks.rival_methods.whole_command JOB`, with the JSON file of a `Job`.
"""

import dataclasses
import json
import sys
from pathlib import Path
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from benchmarks.rival_methods.denoising import denoised_image
from lumitree.core.backend import load_mitsuba
from lumitree.lamp.source import LuminaireSource

# In order of the tables; "light" is a light tracer, with a path tracer where it sees nothing.
MethodName = Literal["baked", "explicit", "path", "light"]
# Strata of a pixel, a side, that tell whether it shows rough surfaces alone.
_STRATA = 4


@dataclasses.dataclass(frozen=True)
class Job:
    """An image.

    Attributes:
        method: "baked" and "explicit" by `lumitree_path`; "path", the explicit lamp by Mitsuba's
            `path`, or by `volpath` where it has media; "light", by `ptracer` where rough surfaces
            are seen, and by the path tracer elsewhere, with as many samples each.
        room: file of the room.
        eye, target: where the camera is and looks, scene units, y up.
        fov: horizontal field of view, degrees.
        lamp: asset or luminaire; `materials`: overrides of a luminaire.
        at, size: of a `Placement`.
        width: pixels.
        path_depth: longest path.
        samples: a pixel.
        seed: of all random numbers.
        variant: of Mitsuba.
        output: `.npy` file of the image, float32 [H, W, 3].
    """

    method: MethodName
    room: str
    eye: tuple[float, float, float]
    target: tuple[float, float, float]
    fov: float
    lamp: str
    materials: str | None
    at: tuple[float, float, float]
    size: float
    width: int
    path_depth: int
    samples: int
    seed: int
    variant: str
    output: str


def image(job: Job) -> NDArray[np.float32]:
    """The denoised image [H, W, 3], W/(m² sr)."""
    mi = load_mitsuba(job.variant)
    from lumitree.rendering.layers import Layers, denoised, recording
    from lumitree.rendering.passes import Budget, render_passes
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import load_scene, open_placements, place_luminaires

    source = job.lamp if job.method == "baked" else LuminaireSource(job.lamp, job.materials)
    placed = open_placements([Placement(source, at=job.at, size=job.size)])
    room, _ = load_scene(job.room, placed, box_filter=True, width=job.width)
    camera = mi.traverse(room.sensors()[0])
    look = mi.ScalarTransform4f().look_at(list(job.eye), list(job.target), [0, 1, 0])
    camera["to_world"], camera["x_fov"] = mi.Transform4f(look), job.fov
    camera.update()
    scene = place_luminaires(room, placed, appearance="geometry")
    luminaire = placed[0].luminaire

    def rendered(kind: str, **properties: Any) -> Any:
        """Channels of an image."""
        integrator = mi.load_dict({"type": kind, **properties})
        return render_passes(scene, integrator, Budget(job.samples), seed=job.seed).channels

    depth = {"max_depth": job.path_depth}
    if job.method in ("baked", "explicit"):
        layers, integrator = Layers(scene), mi.load_dict({"type": "lumitree_path", **depth})
        with recording(integrator, layers):
            found = render_passes(scene, integrator, Budget(job.samples), seed=job.seed).channels
        further = len(layers.channel_names())
        return denoised(layers.divide(found[..., -further:])).radiance.sum(axis=0)
    has_media = luminaire is not None and luminaire.has_media
    traced: dict[str, Any] = {"type": "volpath" if has_media else "path", **depth}
    found = rendered("aov", aovs="albedo:albedo,normal:sh_normal", traced=traced)
    radiance = found[..., :3]
    if job.method == "light":
        # `ptracer` cannot show emitters, and sees nothing through or by smooth surfaces.
        light = rendered("ptracer", hide_emitters=True, **depth)[..., :3]
        radiance = np.where(shows_rough(scene)[..., None], light, radiance)
    return denoised_image(radiance, found[..., -6:-3], found[..., -3:])


def shows_rough(scene: Any) -> NDArray[np.bool_]:
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
    return np.asarray(~smooth.any(axis=(1, 3)), np.bool_)


if __name__ == "__main__":
    described = Job(**json.loads(Path(sys.argv[1]).read_text(encoding="utf-8")))
    np.save(described.output, image(described))
