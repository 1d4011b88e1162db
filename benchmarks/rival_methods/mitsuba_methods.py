"""The methods of Mitsuba: the explicit lamp, simpler lamps of the same flux, and the baked lamp."""

import dataclasses
import gc
from collections.abc import Callable, Iterator, Sequence
from typing import Any

import numpy as np

from benchmarks.common.demo_lamps import placed, sphere_room
from benchmarks.common.timing import Clock
from benchmarks.equal_error.batches import code_digest
from benchmarks.rival_methods.method import PATH_DEPTH, Method, TimedImage
from benchmarks.rival_methods.room import Room
from lumitree.core.backend import load_mitsuba

# Cells a side, 2 to this power, of a light field whose cells stand for points.
_POINT_DEPTH = 7
# So many that the time for recording kernels counts little.
_SAMPLES = 32


class MitsubaRenderer:
    """Renders one scene.

    Args:
        make: returns the scene (mi.Scene).
        integrator: name of the plugin.
    """

    def __init__(self, make: Callable[[], Any], integrator: str) -> None:
        self._make, self._integrator = make, integrator

    def images(self, samples: int, seeds: Sequence[int]) -> Iterator[TimedImage]:
        """As `Renderer.images`."""
        from lumitree.rendering.passes import Budget, render_passes

        # Kernels have the code of all plugins that exist, so other methods' scenes may not.
        gc.collect()
        scene, described = self._make(), {"type": self._integrator, "max_depth": PATH_DEPTH}
        if self._integrator == "ptracer":
            # A baked lamp has no points that could be connected to the camera.
            described["hide_emitters"] = True
        integrator = load_mitsuba().load_dict(described)
        # Kernels are compiled first.
        render_passes(scene, integrator, Budget(samples), seed=seeds[0])
        for seed in seeds:
            clock = Clock()
            image = render_passes(scene, integrator, Budget(samples), seed=seed).radiance
            yield TimedImage(image, clock.read())


def mitsuba_methods(source: Any, asset: Any, room: Room) -> list[Method]:
    """The methods for a lamp.

    Args:
        source: of the explicit luminaire, as for `load_luminaire`.
        asset: its bake, with a light field and geometry.
        room: where it hangs.
    """
    from lumitree.lamp.luminaire import load_luminaire

    luminaire = load_luminaire(source)
    code = {"code": code_digest(), "mitsuba": load_mitsuba().__version__}

    def hung(what: Any, **options: Any) -> Any:
        return placed(what, room.width, room.mitsuba(), **options)

    def method(
        name: str, label: str, make: Callable[[], Any], integrator: str, **facts: Any
    ) -> Method:
        return Method(
            name,
            label,
            MitsubaRenderer(make, integrator),
            first_samples=_SAMPLES,
            key=code,
            **facts,
        )

    def explicit() -> Any:
        return hung(source)

    def light() -> Any:
        return hung(asset)

    def points(count: int) -> Callable[[], Any]:
        return lambda: hung(point_lights_asset(asset, count))

    tracer = "volpath" if luminaire.has_media else "path"
    lost = ("media are ignored",) if luminaire.has_media else ()
    return [
        method(
            "baked",
            "baked, with the model",
            lambda: hung(asset, appearance="geometry"),
            "lumitree_path",
        ),
        method("light", "baked, light field alone", light, "lumitree_path", whole_image=False),
        method("baked-ptracer", "baked, light tracer", light, "ptracer", whole_image=False),
        method("path", f"Mitsuba `{tracer}`", explicit, tracer),
        method("lumitree-path", "Mitsuba with `lumitree_path`", explicit, "lumitree_path"),
        method("ptracer", "Mitsuba `ptracer`", explicit, "ptracer", whole_image=False, lost=lost),
        method("far-field", "far field, point", points(1), "lumitree_path", whole_image=False),
        method("points-16", "16 point lights", points(16), "lumitree_path", whole_image=False),
        method("points-128", "128 point lights", points(128), "lumitree_path", whole_image=False),
        method(
            "sphere",
            "sphere of the same flux",
            lambda: sphere_room(asset, room.width, room.mitsuba()),
            "lumitree_path",
            whole_image=False,
        ),
    ]


def point_lights_asset(asset: Any, count: int) -> Any:
    """An asset with at most `count` light sources in place of a light field.

    Each source is a cell of a grid of 128³ about the centroid of a cluster, with the cluster's
    intensity by direction. Light starts in the cell, and so nearly in a point.
    """
    from lumitree.asset.asset import light_field_asset
    from lumitree.asset.light_field import make_light_field
    from lumitree.exports.point_lights import cluster_lights

    half = asset.frame.half_extents
    lights = cluster_lights(asset.light_field, half, count)
    side = 1 << _POINT_DEPTH
    cells = np.clip(((lights.position + 1) * (side / 2)).astype(np.int64), 0, side - 1)
    cells, index = np.unique(cells, axis=0, return_inverse=True)
    intensity = np.zeros((len(cells), *lights.intensity.shape[1:]))
    np.add.at(intensity, index.ravel(), lights.intensity)
    field = make_light_field(cells, intensity, _POINT_DEPTH)
    made = light_field_asset(field, asset.frame, asset.luminaire)
    return dataclasses.replace(made, light_factors=asset.light_factors)
