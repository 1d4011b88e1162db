"""Shadow rays of `lumitree_path`: transmittance between a receiver and a light."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.rendering.plugins.emitter_calls import entered_transmittance
from lumitree.rendering.plugins.geometry_plugins import CROSSED_STRAIGHT
from lumitree.rendering.plugins.path_scene import PathScene
from lumitree.rendering.plugins.proxies import MAX_CROSSINGS, NONE
from lumitree.trace import medium_paths
from lumitree.trace.spawning import offset, spawn


@dr.syntax
def visible(
    scene: PathScene,
    si: mi.SurfaceInteraction3f,
    ds: mi.DirectionSample3f,
    beyond: mi.Float,
    target: mi.UInt32,
    medium: mi.MediumPtr,
    active: mi.Bool,
) -> mi.Spectrum:
    """Transmittance from a surface to a sampled point: 0 behind what is not null.

    For a length `beyond` after the point, surfaces of the room block, but not the sampled
    lamp's, whose index in the scene is `target`.
    """
    surfaces, proxies, room, passes, _ = scene.divided
    # Like Mitsuba's, a shadow ray ends before its goal; and by no less than it starts after its
    # origin, so that rounding does not bring it to the goal.
    margin = dr.maximum(ds.dist * mi.math.ShadowEpsilon, offset(si, scene.extent))
    ray, left = _spawn_to(si, ds.p, ds.d, margin, scene.extent, active)
    if dr.hint(scene.has_media, mode="scalar"):
        medium = medium_paths.medium_after(si, ds.d, medium, left)
    through = _transmittance(scene, surfaces, False, target, margin, ray, ds.p, medium, left)
    if dr.hint(room is not None, mode="scalar"):
        assert room is not None
        onwards = active & (beyond > 0) & (dr.max(through) > 0)
        rest = mi.Ray3f(ray)
        rest.o = dr.select(left, ds.p, ray.o)
        rest.d, rest.maxt = ds.d, beyond
        goal = dr.fma(beyond, ds.d, rest.o)
        none = dr.zeros(mi.MediumPtr)
        through *= _transmittance(
            scene, room, passes, target, mi.Float(0), rest, goal, none, onwards
        )
    if dr.hint(proxies.dim, mode="scalar"):
        crossed = left & (dr.max(through) > 0)
        distance, lamp = proxies.first(ray, ray.maxt, crossed)
        crossed &= lamp != NONE
        # Of lamps that overlap, each dims all light of the other, as along rays that enter both.
        whole = mi.Ray3f(ray)
        whole.maxt = dr.select(scene.divided.owners.bit(target, active) != 0, dr.inf, ray.maxt)
        while crossed:
            emitter = scene.emitter(lamp, crossed)
            dimmed = scene.lamps.call(entered_transmittance, emitter, whole, distance, crossed)
            # Its own light is as it is seen through the lamp.
            through *= dr.select(crossed & (lamp != target), dimmed, 1)
            distance, lamp = proxies.next(ray, distance, lamp, ray.maxt, crossed)
            crossed &= lamp != NONE
    return through


@dr.syntax
def _transmittance(
    scene: PathScene,
    traced: mi.Scene,
    passes: bool,
    target: mi.UInt32,
    margin: mi.Float,
    ray: mi.Ray3f,
    goal: mi.Point3f,
    medium: mi.MediumPtr,
    active: mi.Bool,
) -> mi.Spectrum:
    """Transmittance of surfaces (`traced`), and of media, along a ray towards a sampled point.

    Glass of the lamp `target` blocks: what passes it is contained in the lamp's light. With
    `passes` none of its surfaces blocks.
    """
    through, ray, direction = mi.Spectrum(1), mi.Ray3f(ray), mi.Vector3f(ray.d)
    if dr.hint(not (scene.has_null_surfaces or passes), mode="scalar"):
        # Of a length below 0, of which nothing is left, it tells a hit although it is not active.
        through[active & traced.ray_test(ray, active)] = 0
        if dr.hint(scene.has_media, mode="scalar"):
            through *= medium_paths.transmittance(medium, ray.maxt, active, ray.wavelengths)
    else:
        owners = scene.divided.owners
        crossings = mi.UInt32(0)
        while active:
            pi = traced.ray_intersect_preliminary(ray, coherent=False, active=active)
            hit = active & pi.is_valid()
            if dr.hint(scene.has_media, mode="scalar"):
                length = dr.minimum(pi.t, ray.maxt)
                through *= medium_paths.transmittance(medium, length, active, ray.wavelengths)
            bsdf = pi.shape.bsdf()
            flags = bsdf.flags()
            null = hit & mi.has_flag(flags, mi.BSDFFlags.Null)
            own = mi.Bool(False)
            if dr.hint(owners.exist, mode="scalar"):
                own = hit & (owners.of(pi.shape, hit) == target)
                if dr.hint(passes, mode="scalar"):
                    null |= own
                else:
                    null &= ~(own & ((flags & CROSSED_STRAIGHT) != 0))
                    own = mi.Bool(False)
            crossing = pi.compute_surface_interaction(ray, mi.RayFlags.All, null)
            part = dr.select(own, 1, bsdf.eval_null_transmission(crossing, null & ~own))
            through[hit] *= dr.select(null, part, 0)
            crossings += 1
            through[null & (crossings >= MAX_CROSSINGS)] = 0
            null &= dr.max(through) > 0
            if dr.hint(scene.has_media, mode="scalar"):
                medium = medium_paths.medium_after(crossing, direction, medium, null & ~own)
            extent = scene.extent
            ray[null], active = _spawn_to(crossing, goal, direction, margin, extent, null)
    return through


def _spawn_to(
    si: mi.SurfaceInteraction3f,
    goal: mi.Point3f,
    direction: mi.Vector3f,
    margin: mi.Float,
    extent: mi.Float,
    active: mi.Bool,
) -> tuple[mi.Ray3f, mi.Bool]:
    """Ray from a surface towards a point in a direction, and whether anything of it is left.

    Where an offset has brought it past the point, a ray that turned round would meet the same
    surface for ever.
    """
    origin = spawn(si, direction, extent).o
    segment = goal - origin
    length = dr.norm(segment)
    left = dr.dot(segment, direction) > margin
    ray = mi.Ray3f(origin, segment / length, length - margin, si.time, si.wavelengths)
    return ray, active & left
