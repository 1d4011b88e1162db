"""Irradiance that baked luminaires send to points of a scene, as `lumitree_path` receives it."""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.device import on_device
from lumitree.core.seeds import Purpose, SeedStream
from lumitree.rendering.plugins.deferred_emitter import DeferredEmitter
from lumitree.rendering.plugins.emitter_calls import entered_light, eval_target, sample_target
from lumitree.rendering.plugins.path_scene import PathScene
from lumitree.rendering.plugins.proxies import NONE, DividedScene
from lumitree.rendering.plugins.shadow_rays import visible

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
        place = [np.repeat(each, count, axis=0) for each in (points, normals)]
        light = _receive(paths, on_device(mi.Point3f, place[0]), place[1], sampler)
        total += np.array(light, np.float64).T.reshape(len(points), count, 3).sum(axis=1)
    return total / samples


@dr.syntax
def _receive(scene, point, normal, sampler):
    """Estimates (mi.Color3f) of the irradiance at points."""
    surfaces, proxies, _, owners = scene.divided
    si = dr.zeros(mi.SurfaceInteraction3f, dr.width(point))
    si.p, si.n = point, dr.normalize(on_device(mi.Vector3f, normal))
    si.sh_frame = mi.Frame3f(si.n)
    active = dr.full(mi.Bool, True, dr.width(point))
    none = dr.zeros(mi.MediumPtr)

    index, emitter_weight, choice = scene.whole.sample_emitter(sampler.next_1d(), active)
    emitter = scene.emitter(index, active)
    sample = mi.Point2f(choice, sampler.next_1d())
    sampled = dr.dispatch(emitter, sample_target, si, sample, active)
    ds, beyond = sampled.ds, sampled.beyond
    cosine = dr.maximum(dr.dot(si.n, ds.d), 0)
    found = active & sampled.valid & (cosine > 0) & dr.dispatch(emitter, is_baked, active)
    through = visible(scene, si, ds, beyond, index, none, found)
    weight, _ = dr.dispatch(
        emitter,
        eval_target,
        si,
        sampled,
        cosine * (1 / math.pi),
        dr.rcp(emitter_weight),
        found,
    )
    irradiance = dr.select(found, weight * through * (cosine * emitter_weight), 0)

    local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    ray = mi.Ray3f(si.p, si.to_world(local))
    # A ray along the surface has no density, and brings nothing.
    active &= local.z > 0
    pi = surfaces.ray_intersect_preliminary(ray, False, active)
    distance, lamp = proxies.first(ray, pi.t, active)
    entered = active & (lamp != NONE)
    ahead = owners.of(pi.shape, entered & pi.is_valid())
    while entered:
        ends = scene.divided.ends(ray, pi.t, lamp, ahead, entered)
        emitter = scene.emitter(lamp, entered)
        emitter_pmf = scene.emitter_pmf(emitter)
        pdf = local.z * (1 / math.pi)
        light, _, _ = dr.dispatch(
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
        )
        irradiance[entered] += light * math.pi
        distance, lamp = proxies.next(ray, distance, lamp, pi.t, entered)
        entered &= lamp != NONE
    return irradiance


def is_baked(emitter: Any, active: Any) -> Any:
    """Whether an emitter is a baked luminaire."""
    return mi.Bool(isinstance(emitter, DeferredEmitter)) & active
