"""Irradiance that baked luminaires send to points of a scene, as `lumitree_path` receives it."""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.seeds import Purpose, SeedStream
from lumitree.measure.illuminance.light import emitter_light, receivers
from lumitree.rendering.plugins.deferred_emitter import DeferredEmitter
from lumitree.rendering.plugins.emitter_calls import entered_light
from lumitree.rendering.plugins.path_scene import PathScene
from lumitree.rendering.plugins.proxies import NONE, DividedScene

# Samples that are computed at once.
_AT_ONCE = 1 << 22


def received_irradiance(
    scene: Any, points: ArrayLike, normals: ArrayLike, samples: int, seed: int = 0
) -> NDArray[np.float64]:
    """Irradiance [N, 3] that the baked luminaires of a scene send to points straight.

    It is what a white diffuse surface there would scatter in an image of `lumitree_path`, by
    next-event estimation and by rays of its BSDF, without what other surfaces reflect. Units: those
    of radiance in the scene times sr.

    Args:
        scene: mi.Scene with luminaires placed.
        points: [N, 3], scene coordinates; in free space or on surfaces.
        normals: [N, 3], of any length.
        samples: of each point.
        seed: root seed of the random numbers.
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    normals = np.asarray(normals, np.float64).reshape(-1, 3)
    for emitter in scene.emitters():
        if isinstance(emitter, DeferredEmitter):
            emitter.light_inside()
    paths = PathScene(scene, DividedScene().of(scene))
    total = np.zeros(points.shape)
    at_once = max(1, _AT_ONCE // len(points))
    for step, first in enumerate(range(0, samples, at_once)):
        count = min(at_once, samples - first)
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(SeedStream(Purpose.RECEIVED, step).seed(seed), count * len(points))
        light = _receive(paths, receivers(points, normals, count), sampler)
        total += np.array(light, np.float64).T.reshape(len(points), count, 3).sum(axis=1)
    return total / samples


@dr.syntax
def _receive(scene, si, sampler):
    """Estimates (mi.Color3f) of the irradiance of receivers."""
    proxies, owners = scene.divided.proxies, scene.divided.owners
    active = dr.full(mi.Bool, True, dr.width(si.p))
    sampled = emitter_light(scene, si, dr.zeros(mi.MediumPtr), sampler, 1 / math.pi)
    baked = dr.dispatch(sampled.emitter, is_baked, sampled.found)
    irradiance = dr.select(baked, sampled.unshadowed * sampled.through, 0)

    local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    ray = mi.Ray3f(si.p, si.to_world(local))
    # A ray along the surface has no density, and brings nothing.
    active &= local.z > 0
    pi = scene.divided.surfaces.ray_intersect_preliminary(ray, False, active)
    distance, lamp = proxies.first(ray, pi.t, active)
    entered = active & (lamp != NONE)
    ahead = owners.of(pi.shape, entered & pi.is_valid())
    while entered:
        ends = scene.divided.ends(ray, pi.t, lamp, ahead, entered)
        emitter = scene.emitter(lamp, entered)
        emitter_pmf = scene.selection.pmf(emitter, mi.Interaction3f(si), entered)
        pdf = local.z * (1 / math.pi)
        light = dr.dispatch(
            emitter,
            entered_light,
            ray,
            distance,
            mi.Interaction3f(si),
            mi.Bool(False),
            pdf,
            emitter_pmf,
            ends,
            entered,
        )[0]
        irradiance[entered] += light * math.pi
        distance, lamp = proxies.next(ray, distance, lamp, pi.t, entered)
        entered &= lamp != NONE
    return irradiance


def is_baked(emitter: Any, active: Any) -> Any:
    """Whether an emitter is a baked luminaire."""
    return mi.Bool(isinstance(emitter, DeferredEmitter)) & active
