"""Directions and lines drawn from what a field emits, mixed with uniform ones.

In the luminaire's local frame. The uniform part keeps every density positive where light may come
from, and every sample's weight below radiance times 4 pi over its fraction, however close it is.
"""

from typing import Any

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.render.light_boxes import NO_BOX, LightBoxes
from lumitree.render.proxy import Proxy, cone_pdf, point_on_box, projected_areas, sample_cone

SAMPLING_KINDS = ("emission", "uniform")
# Part of the samples that is taken uniformly.
UNIFORM_FRACTION = 0.1


class EmitterSampler:
    """Directions towards a field: its boxes mixed with the proxy's uniform sampling.

    Args:
        proxy: what is sampled uniformly.
        half_extents: [3] the box around the field, local units.
        boxes: None for uniform sampling alone.
    """

    def __init__(
        self, proxy: Proxy, half_extents: NDArray[np.float64], boxes: LightBoxes | None
    ) -> None:
        self._proxy = proxy
        self._half = mi.Vector3f(*half_extents.tolist())
        self._radius = float(np.linalg.norm(half_extents))
        self._boxes = boxes

    def sample(self, origin: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Unit direction from `origin` for a sample in the unit square, and its density.

        Args:
            origin: mi.Point3f, local frame.
            sample: mi.Point2f.
            active: mi.Bool mask.

        Returns:
            mi.Vector3f; mi.Float per steradian, 0 where there is no valid direction.
        """
        if self._boxes is None:
            direction = self._proxy.sample(origin, sample)
            return direction, self._proxy.pdf(origin, direction)
        uniform, rest = _divide_sample(sample.x)
        sample = mi.Point2f(rest, sample.y)
        aimed, box = self._boxes.sample(origin, sample, active)
        direction = dr.select(uniform, sample_cone(origin, self._radius, sample), aimed)
        box = dr.select(uniform, NO_BOX, box)
        return direction, self._density(origin, direction, active, box)

    def pdf(self, origin: Any, direction: Any, active: Any = True) -> Any:
        """Density with which `sample` gives `direction` from `origin`, per steradian."""
        if self._boxes is None:
            return self._proxy.pdf(origin, direction)
        return self._density(origin, direction, active, mi.UInt32(NO_BOX))

    def sample_line(
        self, choice: Any, sample1: Any, sample2: Any, active: Any = True
    ) -> tuple[Any, Any, Any]:
        """Line along which light leaves the lamp.

        Args:
            choice: mi.Float in [0, 1).
            sample1, sample2: mi.Point2f in the unit square.
            active: mi.Bool mask.

        Returns:
            A point of the line inside the proxy, the unit direction of travel, and the density over
            projected area (local units) and solid angle.
        """
        direction = mi.warp.square_to_uniform_sphere(sample1)
        areas = projected_areas(self._half, direction)
        point = point_on_box(self._half, areas, direction, sample2)
        if self._boxes is None:
            return mi.Point3f(point), direction, dr.inv_four_pi / dr.sum(areas)
        uniform, rest = _divide_sample(choice)
        aimed_point, aimed = self._boxes.sample_line(rest, sample1, sample2)
        point = dr.select(uniform, point, aimed_point)
        direction = dr.select(uniform, direction, aimed)
        density = dr.inv_four_pi / dr.sum(projected_areas(self._half, direction))
        aimed_density = self._boxes.line_pdf(point, direction, active)
        return mi.Point3f(point), direction, dr.lerp(aimed_density, density, UNIFORM_FRACTION)

    def _density(self, origin, direction, active, box):
        # Where the proxy's own density is 0 nothing is emitted: from inside, and past it.
        valid = self._proxy.pdf(origin, direction) > 0
        aimed = self._boxes.pdf(origin, direction, active & valid, box)
        uniform = cone_pdf(origin, self._radius)
        return dr.select(valid, dr.lerp(aimed, uniform, UNIFORM_FRACTION), 0)


def _divide_sample(sample):
    """Whether to sample uniformly, and a sample in [0, 1) to do either with."""
    uniform = sample < UNIFORM_FRACTION
    rest = (sample - UNIFORM_FRACTION) / (1 - UNIFORM_FRACTION)
    rest = dr.select(uniform, sample / UNIFORM_FRACTION, rest)
    return uniform, dr.clip(rest, 0, dr.one_minus_epsilon(mi.Float))
