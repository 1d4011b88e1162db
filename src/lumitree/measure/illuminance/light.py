"""Light that receivers get, sampled on the device.

A receiver is a point with a normal, in free space or on a surface. Its light comes straight from
emitters, by emitter sampling, or from surfaces and media, by paths as `lumitree_path` traces them.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.core.device import on_device
from lumitree.rendering.integrator import (
    DEFAULT_RR_DEPTH,
    PathScene,
    PathState,
    trace_paths,
    visible,
)
from lumitree.rendering.proxies import NONE
from lumitree.rendering.sampling import OUTSIDE
from lumitree.trace import medium_paths
from lumitree.trace.spawning import spawn


@dataclass
class EmitterLight:
    """Irradiance by one sampled direction of one sampled emitter (a PyTree of Dr.Jit)."""

    # fmt: off
    emitter: mi.EmitterPtr
    unshadowed: mi.Spectrum  # Irradiance if nothing is in between
    through: mi.Spectrum     # Transmittance of what is in between
    found: mi.Bool           # Whether there is any light
    stored: mi.Bool          # Whether it is of a light field, for a receiver outside the box
    # fmt: on


def receivers(
    points: NDArray[np.floating], normals: NDArray[np.floating], count: int
) -> mi.SurfaceInteraction3f:
    """Receivers on the device, each `count` times in succession.

    Args:
        points: [N, 3].
        normals: [N, 3], of any length.
    """
    place = [np.repeat(each, count, axis=0) for each in (points, normals)]
    si = dr.zeros(mi.SurfaceInteraction3f, len(points) * count)
    si.p = on_device(mi.Point3f, place[0])
    si.n = dr.normalize(on_device(mi.Vector3f, place[1]))
    si.sh_frame = mi.Frame3f(si.n)
    return si


def medium_at(scene: PathScene, si: mi.SurfaceInteraction3f) -> mi.MediumPtr:
    """Medium that receivers are in: that on this side of the first border along their normals."""
    if not scene.has_media:
        return dr.zeros(mi.MediumPtr, dr.width(si.p))
    owners = scene.divided.owners

    def is_border(hit: mi.SurfaceInteraction3f, active: mi.Bool) -> mi.Bool:
        # The glass of a placed lamp does not say what is around it.
        return hit.is_medium_transition() & (owners.of(hit.shape, active) == NONE)

    ray = spawn(si, mi.Vector3f(si.n), scene.extent)
    return medium_paths.medium_around(scene.divided.surfaces, ray, scene.extent, is_border)


def emitter_light(
    scene: PathScene,
    si: mi.SurfaceInteraction3f,
    medium: mi.MediumPtr,
    sampler: mi.Sampler,
    bsdf_pdf: float = 0,
) -> EmitterLight:
    """Irradiance by emitter sampling, of receivers in `medium`, see `medium_at`.

    `bsdf_pdf` is the density per steradian and cosine with which directions are also sampled
    otherwise, for the weight of multiple importance sampling of baked luminaires.
    """
    active = dr.full(mi.Bool, True, dr.width(si.p))
    # By what each lamp sends there: of many, that which is shadowed may give most of the light.
    selected = scene.selection.sample(si, mi.Vector3f(si.n), mi.UInt32(NONE), sampler, active)
    active &= selected.weight > 0
    emitter = scene.emitter(selected.index, active)
    self_light = mi.Bool(False)
    sampled = scene.lamps.call("sample_target", emitter, si, selected.sample, self_light, active)
    ds = sampled.ds
    cosine = dr.maximum(dr.dot(si.n, ds.d), 0)
    found = active & sampled.valid & (cosine > 0)
    through = visible(scene, si, ds, sampled.beyond, selected.index, medium, found)
    weight = scene.lamps.call(
        "eval_target", emitter, si, sampled, cosine * bsdf_pdf, selected.emitter_pmf, found
    )
    light = dr.select(found, weight * (cosine * selected.weight), 0)
    return EmitterLight(emitter, light, through, found, sampled.target.place == OUTSIDE)


def behind_surfaces(scene: PathScene, si: mi.SurfaceInteraction3f, sampler: mi.Sampler) -> mi.Bool:
    """Whether a ray in a random direction ends at the back of a surface: inside a solid, all do."""
    direction = mi.warp.square_to_uniform_sphere(sampler.next_2d())
    # From where the receiver's own light starts, which may be on a surface.
    start = spawn(si, mi.Vector3f(si.n), scene.extent).o
    hit = scene.divided.surfaces.ray_intersect(mi.Ray3f(start, direction))
    return hit.is_valid() & (dr.dot(hit.n, direction) > 0)


def summed_part(scene: PathScene, si: mi.SurfaceInteraction3f, light: EmitterLight) -> mi.Bool:
    """Whether the emitter's irradiance is known without sampling directions."""
    return light.stored & scene.lamps.call("is_summed", light.emitter, si.p, light.found)


def reflected_light(
    scene: PathScene, si: mi.SurfaceInteraction3f, medium: mi.MediumPtr, sampler: mi.Sampler
) -> mi.Spectrum:
    """Irradiance by one path of light from surfaces and media, of any length."""
    local = mi.warp.square_to_cosine_hemisphere(sampler.next_2d())
    # A ray along the surface has no density, and brings nothing.
    ray = spawn(si, si.to_world(local), scene.extent)
    path = PathState.received(mi.Interaction3f(si), ray, medium, local.z > 0)
    radiance, _, _ = trace_paths(scene, path, sampler, -1, DEFAULT_RR_DEPTH)
    return math.pi * radiance
