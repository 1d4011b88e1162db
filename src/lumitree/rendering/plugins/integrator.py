"""The integrator `lumitree_path`: Mitsuba's `path`, which also walks through null surfaces.

A null interaction (a baked luminaire's proxy, a hole of an alpha mask) bends no ray. So it counts
neither towards `max_depth` nor for Russian roulette, it keeps the state of multiple importance
sampling (the vertex before it and the density of the direction sampled there), and shadow rays
cross it with the transmittance that its BSDF states.

Homogeneous media attenuate and scatter light along each segment (`medium_paths`). A scattering is a
vertex like one on a rough surface. Heterogeneous media need `volpath`, and are refused.

Opaque BSDFs do not scatter light through the geometric surface (`geometric_normals`), as `path`
lets them do where shading normals are smooth.

Proxies are not traced. The integrator traces the other shapes as a scene of their own, and finds
the proxies that a ray enters by itself (`proxies.DividedScene`).

Where images show the geometry of a lamp, its shapes are in the scene, and each path gets its light
once. As long as all vertices since the camera are specular or on surfaces of this lamp, the path
gets what the lamp's shapes emit (`self_emission`). A scattering in a medium of the lamp's geometry
counts as a vertex on the lamp. Vertices elsewhere, inside its box too, get what the shapes emit
straight, through nothing that bends it, and the light field, which contains all light that the
lamp's surfaces bend or scatter: so these surfaces get none of it again.
After the first vertex that is not specular, the lamp's glass bends no ray (`geometry_plugins`),
and a crossing of it is a null interaction.

`trace_paths` is the loop. Its blocks are functions of `path_segments` (media and proxies along a
ray), `path_emission` (emitters that are hit, and emitter sampling) and `path_vertices`
(scattering). They read a `PathScene` and change a `PathState`. docs/emitter-samples.md follows a
sample through them.
"""

from __future__ import annotations

from collections.abc import Sequence

import drjit as dr
import mitsuba as mi

from lumitree.errors import LumitreeError
from lumitree.lamp.media import media
from lumitree.rendering.layers import Layers, Unrecorded
from lumitree.rendering.plugins.bsdf import proxies_left_out
from lumitree.rendering.plugins.path_emission import (
    add_emission,
    add_emitter_light,
    sample_emitter,
)
from lumitree.rendering.plugins.path_scene import PathScene
from lumitree.rendering.plugins.path_segments import (
    add_entered_light,
    end_segment,
    sample_free_flight,
    skip_emitters,
)
from lumitree.rendering.plugins.path_state import PathState
from lumitree.rendering.plugins.path_vertices import (
    find_vertex,
    roulette,
    sample_scattering,
    scatter,
)
from lumitree.rendering.plugins.proxies import DividedScene
from lumitree.rendering.sampling.lamp_choice import LampChoices
from lumitree.trace import medium_paths

DEFAULT_RR_DEPTH = 5


def integrator_class() -> type:
    """Class of `lumitree_path` for the variant of Mitsuba that is set.

    It has the properties of `path`: `max_depth` (-1: no limit), `rr_depth` and `hide_emitters`,
    which hides baked luminaires from the camera as other area lights.
    """

    class LumitreePath(mi.SamplingIntegrator):
        # Other integrators cannot divide the light of a lamp whose geometry is in the scene.
        shows_geometry = True

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.max_depth = int(props.get("max_depth", -1))
            self.rr_depth = int(props.get("rr_depth", DEFAULT_RR_DEPTH))
            # What is recorded beside the image.
            self.layers: Layers | Unrecorded = Unrecorded()
            self._divided = DividedScene()
            self._choices = LampChoices()
            if self.max_depth < -1 or self.rr_depth < 1:
                raise LumitreeError(
                    f"lumitree_path has max_depth {self.max_depth} and rr_depth {self.rr_depth}; "
                    "expected max_depth of -1 (no limit) or more and rr_depth of 1 or more"
                )

        def sample(
            self,
            scene: mi.Scene,
            sampler: mi.Sampler,
            ray: mi.RayDifferential3f,
            medium: mi.Medium | None = None,
            active: mi.Bool | bool = True,
        ) -> tuple[mi.Spectrum, mi.Bool, Sequence[mi.Float]]:
            if not scene.emitters():
                nothing = [mi.Float(0) for _ in self.aov_names()]
                return mi.Spectrum(0), scene.ray_test(ray, active), nothing
            crossed = [*media(scene), *([] if medium is None else [medium])]
            if not all(each.is_homogeneous() for each in crossed):
                raise LumitreeError(
                    "a medium is heterogeneous; lumitree_path expects homogeneous media: use "
                    "volpath"
                )
            paths = PathScene(
                scene,
                self._divided.of(scene),
                crossed,
                hide_emitters=self.hide_emitters,
                layers=self.layers,
                choices=self._choices,
            )
            inside = dr.zeros(mi.MediumPtr) if medium is None else mi.MediumPtr(medium)
            path = PathState.start(ray, inside, mi.Bool(active))
            return trace_paths(paths, path, sampler, self.max_depth, self.rr_depth)

        def aov_names(self):
            return self.layers.channel_names()

        def to_string(self) -> str:
            return f"LumitreePath[max_depth={self.max_depth}, rr_depth={self.rr_depth}]"

    return LumitreePath


@proxies_left_out()
@dr.syntax
def trace_paths(
    scene: PathScene, path: PathState, sampler: mi.Sampler, max_depth: int, rr_depth: int
) -> tuple[mi.Spectrum, mi.Bool, list[mi.Float]]:
    """Radiance along rays, whether they met something (for the film's alpha), and layers.

    Args:
        scene: what is traced.
        path: as `PathState.start` or `PathState.received` return it.
        sampler: of as many samples as there are paths.
        max_depth, rr_depth: as of Mitsuba's `path`.
    """
    surfaces = scene.divided.surfaces
    largest_depth = mi.UInt32(max_depth % (1 << 32))  # no limit: the largest number
    path.record = scene.layers.start()
    path.valid_ray |= scene.whole.environment() is not None and not scene.hide_emitters
    if dr.hint(scene.has_scattering, mode="scalar"):
        path.channel = medium_paths.draw_channel(sampler)
    path.active &= path.depth < largest_depth
    path.pi = surfaces.ray_intersect_preliminary(path.ray, coherent=True, active=path.active)

    while path.active:
        # ---------------------- Media along the ray ----------------------

        free_flight = sample_free_flight(scene, path, sampler)

        # ---------------------- Hide area emitters ----------------------

        if dr.hint(scene.hide_emitters, mode="scalar"):
            skip_emitters(scene, path, free_flight, sampler)

        # ---------------------- Proxies along the ray ----------------------

        if dr.hint(scene.divided.proxies.exist, mode="scalar"):
            add_entered_light(scene, path, free_flight)

        # ---------------------- Direct emission ----------------------

        hit = end_segment(scene, path, free_flight)
        add_emission(scene, path, hit)

        # ---------------------- Emitter sampling ----------------------

        vertex = find_vertex(scene, path, hit, free_flight, largest_depth)
        choice = sample_emitter(scene, path, vertex, sampler)
        # One call evaluates the BSDF for the emitter's direction and samples the next.
        scattering = sample_scattering(scene, path, vertex, choice.sampled.ds.d, sampler)
        add_emitter_light(scene, path, vertex, choice, scattering)

        # ---- Update loop variables based on current interaction -----

        bounces = scatter(scene, path, vertex, scattering)

        # ---------------------- Russian roulette ----------------------

        roulette(path, bounces, rr_depth, sampler)

        # ----------------- Find the next interaction -----------------

        path.pi = surfaces.ray_intersect_preliminary(path.ray, coherent=False, active=path.active)

    return path.L, path.valid_ray, scene.layers.channels(path.record)
