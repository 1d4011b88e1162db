"""Irradiance that baked luminaires send to points of a scene, as `lumitree_path` receives it."""

import math
from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import ArrayLike, NDArray

from lumitree.core.seeds import Purpose, SeedStream
from lumitree.measure.illuminance_estimate import emitter_light, receivers
from lumitree.rendering.emitter import lamp_of, lamps_of
from lumitree.rendering.integrator import DEFAULT_RR_DEPTH, PathScene, PathState, trace_paths
from lumitree.rendering.proxies import DividedScene
from lumitree.trace.spawning import spawn

# Samples that are computed at once.
_AT_ONCE = 1 << 22


def received_irradiance(
    scene: Any, points: ArrayLike, normals: ArrayLike, samples: int, seed: int = 0
) -> NDArray[np.float64]:
    """Irradiance [N, 3] that the baked luminaires of a scene send to points straight.

    It is what a white diffuse surface there would scatter in an image of `lumitree_path`, by
    next-event estimation and by rays of its BSDF, without what other surfaces reflect. Units:
    radiance in the scene times sr.

    Args:
        scene: mi.Scene with luminaires placed.
        points: [N, 3], scene coordinates; in free space or on surfaces.
        normals: [N, 3], of any length.
        samples: of each point.
        seed: root seed of the random numbers.
    """
    points = np.asarray(points, np.float64).reshape(-1, 3)
    normals = np.asarray(normals, np.float64).reshape(-1, 3)
    for lamp in lamps_of(scene.emitters()).values():
        lamp.has_receivers = True
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


def _receive(scene, si, sampler):
    """Estimates (mi.Color3f) of the irradiance of receivers."""
    medium = dr.zeros(mi.MediumPtr)
    sampled = emitter_light(scene, si, medium, sampler, 1 / math.pi)
    baked = dr.dispatch(sampled.emitter, is_baked, sampled.found)
    irradiance = dr.select(baked, sampled.unshadowed * sampled.through, 0)

    # The light of lamps that a ray enters, and of their surfaces that it hits.
    local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    ray = spawn(si, si.to_world(local), scene.extent)
    path = PathState.received(mi.Interaction3f(si), ray, medium, local.z > 0)
    path.bsdf_pdf_prev = local.z * (1 / math.pi)
    radiance, _, _ = trace_paths(scene, path, sampler, 2, DEFAULT_RR_DEPTH)
    return irradiance + math.pi * radiance


def is_baked(emitter: Any, active: Any) -> Any:
    """Whether an emitter is a baked luminaire."""
    return mi.Bool(lamp_of(emitter) is not None) & active
