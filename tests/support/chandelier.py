"""A chandelier of bare bulbs on a chain, and the irradiance between its arms and below it."""

import math
from typing import Any

import numpy as np
from numpy.typing import NDArray

from lumitree.core.photometry import LUMA

ARMS, RADIUS = 6, 0.5
BALL_RADIUS, BALL_PATCHES = 0.06, 64
PLANE_HEIGHT, PLANE_POINTS = -0.3, 12
_SAMPLES, _BATCHES = 1 << 12, 8


def chandelier(chain: float) -> dict[str, Any]:
    """Scene of six bare bulbs on arms below a chain of this length, m; up is y."""
    metal = _two_sided({"type": "roughconductor", "material": "Au", "alpha": 0.2})
    white = _two_sided({"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.6}})
    light = {"type": "area", "radiance": {"type": "rgb", "value": [40.0, 30.0, 17.0]}}
    lamp = {"type": "scene", "rod": _rod((0, -0.4, 0), (0, 0.6, 0), 0.02, metal)}
    if chain:
        lamp["chain"] = _rod((0, 0.6, 0), (0, 0.6 + chain, 0), 0.006, white)
    for number, (x, z) in enumerate(_around(0.0, RADIUS)):
        end = (x, 0.05, z)
        lamp[f"arm{number}"] = _rod((0, 0, 0), end, 0.012, metal)
        lamp[f"candle{number}"] = _rod(end, (x, 0.12, z), 0.015, white)
        lamp[f"bulb{number}"] = {
            "type": "sphere",
            "center": [x, 0.15, z],
            "radius": 0.03,
            "bsdf": {"type": "diffuse"},
            "emitter": light,
        }
    return lamp


def _two_sided(bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "twosided", "bsdf": bsdf}


def _rod(begin: Any, end: Any, radius: float, bsdf: dict[str, Any]) -> dict[str, Any]:
    return {"type": "cylinder", "p0": list(begin), "p1": list(end), "radius": radius, "bsdf": bsdf}


def _around(turn: float, radius: float) -> NDArray[np.float64]:
    """[ARMS, 2] x and z of as many points about the axis, from a part of the angle between two."""
    angle = 2 * np.pi * (np.arange(ARMS) + turn) / ARMS
    return radius * np.column_stack([np.cos(angle), np.sin(angle)])


def balls() -> dict[str, Any]:
    """Scene of black balls between the arms, at the height of the bulbs, and a camera far away."""
    black = {"type": "diffuse", "reflectance": {"type": "rgb", "value": 0.0}}
    scene: dict[str, Any] = {"type": "scene", "camera": {"type": "perspective"}}
    for number, (x, z) in enumerate(_around(0.5, 0.6 * RADIUS)):
        scene[f"ball{number}"] = {
            "type": "sphere",
            "center": [x, 0.15, z],
            "radius": BALL_RADIUS,
            "bsdf": black,
        }
    return scene


def receivers() -> dict[str, tuple[NDArray[np.float64], NDArray[np.float64]]]:
    """Points and normals [N, 3] of the balls and of the plane."""
    index = np.arange(BALL_PATCHES) + 0.5
    height, angle = 1 - 2 * index / BALL_PATCHES, np.pi * (1 + 5**0.5) * index
    across = np.sqrt(1 - height**2)
    normals = np.column_stack([across * np.cos(angle), height, across * np.sin(angle)])
    middles = np.insert(_around(0.5, 0.6 * RADIUS), 1, 0.15, axis=1)
    points = (middles[:, None] + 1.001 * BALL_RADIUS * normals).reshape(-1, 3)
    grid = (np.arange(PLANE_POINTS) + 0.5) / PLANE_POINTS * 0.9 - 0.45
    x, z = (each.ravel() for each in np.meshgrid(grid, grid))
    plane = np.column_stack([x, np.full(len(x), PLANE_HEIGHT), z])
    up = np.broadcast_to((0.0, 1.0, 0.0), plane.shape)
    return {"balls": (points, np.tile(normals, (ARMS, 1))), "plane": (plane, up)}


def explicit_irradiance(
    scene: Any, points: NDArray[np.float64], normals: NDArray[np.float64], seed: int
) -> NDArray[np.float64]:
    """Luminance-weighted irradiance [_BATCHES, N]: sampled emitters, and paths of other light."""
    import drjit as dr
    import mitsuba as mi

    from lumitree.core.device import on_device

    paths = mi.load_dict({"type": "path", "max_depth": 16})
    batches = []
    for batch in range(_BATCHES):
        samples = _SAMPLES // _BATCHES
        sampler = mi.load_dict({"type": "independent"})
        sampler.seed(seed + batch, samples * len(points))
        si = dr.zeros(mi.SurfaceInteraction3f, samples * len(points))
        si.p = on_device(mi.Point3f, np.repeat(points, samples, axis=0))
        si.n = on_device(mi.Vector3f, np.repeat(normals, samples, axis=0))
        si.sh_frame = mi.Frame3f(si.n)
        sample, weight = scene.sample_emitter_direction(si, sampler.next_2d())
        direct = weight * dr.maximum(dr.dot(sample.d, si.n), 0)
        ray = si.spawn_ray(si.to_world(mi.warp.square_to_cosine_hemisphere(sampler.next_2d())))
        first = scene.ray_intersect(ray)
        emitted = first.emitter(scene).eval(first)
        radiance, *_ = paths.sample(scene, sampler, mi.RayDifferential3f(ray))
        light = mi.Color3f(direct + math.pi * (radiance - emitted))
        grey = np.array(dr.dot(light, mi.Color3f(LUMA)))
        batches.append(grey.reshape(len(points), samples).mean(axis=1))
    return np.array(batches, np.float64)


def references(chain: float, seed: int) -> dict[str, NDArray[np.float64]]:
    """Irradiance of the receivers with the explicit lamp."""
    import mitsuba as mi

    scene = mi.load_dict(chandelier(chain) | balls())
    return {
        name: explicit_irradiance(scene, points, normals, seed + 1000)
        for name, (points, normals) in receivers().items()
    }


def irradiance_errors(
    asset: Any, reference: dict[str, NDArray[np.float64]]
) -> tuple[dict[str, float], dict[str, float]]:
    """Ratios of the means and RMS differences, baked over explicit, by kind of receivers.

    The RMS is relative, without the noise of the reference.

    Args:
        asset: bake of a chandelier.
        reference: of `references`.
    """
    import mitsuba as mi

    from benchmarks.inside_box.received import received_irradiance
    from lumitree.rendering.placement import Placement
    from lumitree.rendering.scene import PlacedLuminaire, place_luminaires

    placed = PlacedLuminaire(Placement(asset))
    scene = place_luminaires(mi.load_dict(balls()), [placed], appearance="geometry")
    ratio, rms = {}, {}
    for name, (points, normals) in receivers().items():
        baked = received_irradiance(scene, points, normals, _SAMPLES) @ np.array(LUMA)
        mean = reference[name].mean(axis=0)
        noise = (reference[name].var(axis=0, ddof=1) / _BATCHES).sum()
        ratio[name] = float(baked.sum() / mean.sum())
        square = max(((baked - mean) ** 2).sum() - noise, 0.0)
        rms[name] = float(np.sqrt(square / (mean**2).sum()))
    return ratio, rms
