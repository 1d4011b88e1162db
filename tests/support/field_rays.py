"""Rays through fields: known ones with noise to learn from, and some to compare integrals on."""

from typing import Any

import numpy as np

from lumitree.core.device import on_device
from support.fields import leaf_field, random_asset

NUM_RAYS = 16


def random_rays(mi, count, seed):
    """Rays through the ball of radius 1.2, uniform."""
    random = np.random.default_rng(seed)
    direction = random.normal(size=(count, 3))
    direction /= np.linalg.norm(direction, axis=1, keepdims=True)
    origin = random.normal(size=(count, 3))
    origin -= (origin * direction).sum(axis=1, keepdims=True) * direction
    origin *= 1.2 * np.sqrt(random.random((count, 1))) / np.linalg.norm(origin, axis=1)[:, None]
    origin -= 2 * direction
    return on_device(mi.Point3f, origin), on_device(mi.Vector3f, direction)


def joined(kind, first, second):
    """Vectors one after the other."""
    return on_device(kind, np.hstack([np.array(first), np.array(second)]).T)


class FieldRays:
    """Noisy rays of a known field: a radiance is doubled or 0, each with probability ½.

    Args:
        split: half of the light comes as light paths, whose share is 0.
    """

    subject: Any = None

    def __init__(self, mi, truth, noise=True, split=False):
        self._mi, self._truth, self._noise, self._split = mi, truth, noise, split

    def draw(self, count, stream, wanted, light_paths_per_ray=0.0):
        import drjit as dr

        from lumitree.fit.octree.rays import Rays

        mi, seed = self._mi, stream.seed(0)
        origin, direction = random_rays(mi, count, seed)
        chosen = dr.compress(wanted(origin, direction))
        num_rays = dr.width(chosen)
        origin = dr.gather(mi.Point3f, origin, chosen)
        direction = dr.gather(mi.Vector3f, direction, chosen)
        dr.eval(origin, direction)
        if not num_rays:
            return Rays(origin, direction, mi.Float(), mi.Color3f(mi.Float()), mi.Float())
        radiance, through, _ = self._truth.integrate(origin, direction)
        # Opaque, or every step would compile kernels of its own.
        part = dr.opaque(mi.Float, 1 / num_rays)
        share = part * dr.ones(mi.Float, num_rays)
        light = self._noisy(radiance, seed) * part
        if not self._split:
            return Rays(origin, direction, share, light, through)
        # On rays of their own, the unwanted among them.
        other_seed = stream.seed(0, part=1)
        other = random_rays(mi, count, other_seed)
        brought = self._noisy(self._truth.integrate(*other)[0], other_seed) * part
        none = dr.zeros(mi.Float, count)
        return Rays(
            joined(mi.Point3f, origin, other[0]),
            joined(mi.Vector3f, direction, other[1]),
            dr.concat([share, none]),
            joined(mi.Color3f, light, brought) / 2,
            dr.concat([through, none]),
        )

    def draw_opacity(self, count, stream, wanted):
        rays = FieldRays(self._mi, self._truth, noise=False).draw(count, stream, wanted)
        return rays.origin, rays.direction, rays.transmittance

    def draw_pairs(self, count, stream, paths):
        from lumitree.fit.octree.rays import RayPairs

        origin, direction = random_rays(self._mi, count, stream.seed(0))
        radiance, through, _ = self._truth.integrate(origin, direction)
        first, second = (self._noisy(radiance, stream.seed(0, part)) for part in (1, 2))
        return RayPairs(origin, direction, first, second, through)

    def _noisy(self, radiance, seed):
        if not self._noise:
            return radiance
        random = np.random.default_rng([7, seed])
        return radiance * on_device(self._mi.Float, 2.0 * (random.random(radiance.shape[1]) < 0.5))


def truth_and_start(law, seed=3, l_max=1):
    """A field with radiance below 0.5, and one of the same leaves with other values."""
    asset = random_asset(seed, tree_depth=3, l_max=l_max, law=law, max_radiance=1.0)
    random = np.random.default_rng(seed)
    coefficients = 0.5 * asset.coefficients.astype(float)
    coefficients[..., 0] -= 5
    truth, start = leaf_field(asset), leaf_field(asset)
    truth = truth.with_leaves(
        truth.cells, truth.levels, truth.log_density, coefficients.astype(np.float32).ravel()
    )
    start = start.with_leaves(
        start.cells,
        start.levels,
        np.array(start.log_density) + random.choice([-1.0, 1.0], start.num_leaves),
        np.zeros(coefficients.size, np.float32),
    )
    return truth, start


def targeted_rays(seed):
    """Origins and directions [16, 3] of rays through the unit cube.

    Every fourth ray is parallel to an axis, between the planes of cells.
    """
    random = np.random.default_rng(seed)
    directions = random.normal(size=(NUM_RAYS, 3))
    targets = random.uniform(-0.8, 0.8, (NUM_RAYS, 3))
    for i in range(0, NUM_RAYS, 4):
        directions[i] = 0
        directions[i, i // 4 % 3] = random.choice([-1.0, 1.0])
        targets[i] = (random.integers(-16, 16, 3) + 0.5) / 16
    directions /= np.linalg.norm(directions, axis=1, keepdims=True)
    return (targets - 3 * directions).astype(np.float32), directions.astype(np.float32)


def rays_on_device(mi, origins, directions):
    """Rays [N, 3] as mi.Point3f and mi.Vector3f."""
    return on_device(mi.Point3f, origins), on_device(mi.Vector3f, directions)
