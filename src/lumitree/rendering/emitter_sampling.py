"""Directions and lines drawn from what a field emits, mixed with uniform ones.

In the luminaire's local frame. The uniform part keeps every density positive where light may come
from, and every sample's weight below radiance times 4 pi over its fraction, however close it is.

A direction's density is found along its line, together with its radiance. It counts what is drawn
in vain too (see `light_leaves`), so over all directions it adds up to less than 1.
"""

from typing import Any, Literal, get_args

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.octree.field import Field
from lumitree.rendering.light_leaves import LightLeaves, is_reached
from lumitree.rendering.proxy import Proxy, cone_pdf, point_on_box, projected_areas, sample_cone

Sampling = Literal["emission", "uniform"]
SAMPLING_KINDS: tuple[Sampling, ...] = get_args(Sampling)
# Part of the samples that is taken uniformly.
UNIFORM_FRACTION = 0.1


class EmitterSampler:
    """Directions towards a field: its leaves mixed with uniform ones.

    Args:
        proxy: what is sampled uniformly where there are no leaves to be drawn.
        field: what is looked at.
        leaves: None for uniform sampling alone.
    """

    def __init__(self, proxy: Proxy, field: Field, leaves: LightLeaves | None) -> None:
        self._proxy, self._field, self._leaves = proxy, field, leaves
        self._half = mi.Vector3f(*field.asset.half_extents.tolist())
        self._radius = float(np.linalg.norm(field.asset.half_extents))

    def sample(self, x: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Unit direction from `x` for a sample in the unit square, and its target's distance.

        Args:
            x: mi.Point3f, local frame.
            sample: mi.Point2f.
            active: mi.Bool mask.

        Returns:
            mi.Vector3f; mi.Float, distance of the point that was drawn, for `eval`; -inf if none.
        """
        if self._leaves is None:
            return self._proxy.sample(x, sample), mi.Float(-dr.inf)
        uniform, rest = _divide_sample(sample.x)
        sample = mi.Point2f(rest, sample.y)
        offset = self._leaves.sample(x, sample, active) - x
        target = dr.norm(offset)
        direction = dr.select(uniform, sample_cone(x, self._radius, sample), offset / target)
        return direction, dr.select(uniform, -dr.inf, target)

    def eval(
        self, entry: Any, direction: Any, distance: Any, active: Any, target: Any = -dr.inf
    ) -> tuple[Any, Any, Any]:
        """What comes from a direction, and with which density `sample` gives it.

        Args:
            entry: mi.Point3f, where the line enters the proxy.
            direction: mi.Vector3f, unit direction from the shading point to it.
            distance: mi.Float, from the shading point to it.
            active: mi.Bool mask.
            target: as `sample` returned it, for a direction that it gave.

        Returns:
            Radiance (mi.Color3f) and transmittance of the line; mi.Float per steradian, 0 where
            `active` is false and where the light stops before it has reached far enough.
        """
        x = entry - distance * direction
        if self._leaves is None:
            radiance, through = self._field.emission(entry, direction, active)
            return radiance, through, dr.select(active, self._proxy.pdf(x, direction), 0)
        record = self._leaves.record(x, distance)
        radiance, through, found = self._field.integrate(entry, direction, active, *record)
        return radiance, through, self._density(x, distance, target, found, active)

    def pdf(self, entry: Any, direction: Any, distance: Any, active: Any = True) -> Any:
        """Density of `eval` alone, at about the cost of a transmittance."""
        x = entry - distance * direction
        if self._leaves is None:
            return dr.select(active, self._proxy.pdf(x, direction), 0)
        found = self._field.cross(entry, direction, active, *self._leaves.record(x, distance))
        return self._density(x, distance, -dr.inf, found, active)

    def _density(self, x, distance, target, found, active):
        aimed, stop = found
        density = dr.lerp(aimed, cone_pdf(x, self._radius), UNIFORM_FRACTION)
        return dr.select(active & is_reached(target - distance, stop), density, 0)

    def sample_line(
        self, choice: Any, sample1: Any, sample2: Any, active: Any = True
    ) -> tuple[Any, Any, Any, Any]:
        """Line along which light leaves the lamp, and what it carries.

        Args:
            choice: mi.Float in [0, 1).
            sample1, sample2: mi.Point2f in the unit square.
            active: mi.Bool mask.

        Returns:
            A point of the line inside the proxy, the unit direction of travel, the radiance, and
            the density over projected area (local units) and solid angle, 0 where it is rejected.
        """
        direction = mi.warp.square_to_uniform_sphere(sample1)
        areas = projected_areas(self._half, direction)
        point = point_on_box(self._half, areas, direction, sample2)
        if self._leaves is None:
            radiance, _ = self._field.emission(mi.Point3f(point), -direction, active)
            return mi.Point3f(point), direction, radiance, dr.inv_four_pi / dr.sum(areas)
        uniform, rest = _divide_sample(choice)
        aimed_point, aimed = self._leaves.sample_line(rest, sample1, sample2)
        point = mi.Point3f(dr.select(uniform, point, aimed_point))
        direction = dr.select(uniform, direction, aimed)
        record = self._leaves.record_line(direction)
        radiance, _, found = self._field.integrate(point, -direction, active, *record)
        plain = dr.inv_four_pi / dr.sum(projected_areas(self._half, direction))
        density = dr.lerp(found[0], plain, UNIFORM_FRACTION)
        reached = uniform | is_reached(mi.Float(0), found[1])
        return point, direction, radiance, dr.select(reached, density, 0)


def _divide_sample(sample):
    """Whether to sample uniformly, and a sample in [0, 1) to do either with."""
    uniform = sample < UNIFORM_FRACTION
    rest = (sample - UNIFORM_FRACTION) / (1 - UNIFORM_FRACTION)
    rest = dr.select(uniform, sample / UNIFORM_FRACTION, rest)
    return uniform, dr.clip(rest, 0, dr.one_minus_epsilon(mi.Float))
