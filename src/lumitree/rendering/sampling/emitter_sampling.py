"""Sampling of directions and rays in proportion to what a field emits, mixed with uniform sampling.

In the luminaire's local frame. Uniform sampling keeps every density positive where light may come
from, and bounds each sample's weight by the radiance times 4π over `UNIFORM_FRACTION`.

The density of a direction is computed along its ray, together with its radiance. Samples of
`light_leaves` may be rejected, so the density integrates to less than 1.
"""

import math
from dataclasses import dataclass
from typing import Any, Literal, NamedTuple, Protocol, get_args

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.device import parameter
from lumitree.octree.field import Field
from lumitree.rendering.sampling.light_leaves import LightLeaves, is_reached
from lumitree.rendering.sampling.proxy import (
    Proxy,
    cone_pdf,
    point_on_box,
    projected_areas,
    sample_cone,
)
from lumitree.rendering.sampling.samples import divide_sample

Sampling = Literal["emission", "uniform"]
SAMPLING_KINDS: tuple[Sampling, ...] = get_args(Sampling)
# Part of the samples that is taken uniformly.
UNIFORM_FRACTION = 0.1
# Where a receiver is: outside the box, near it, where the lamp's own surfaces block; or inside.
OUTSIDE, NEAR, INSIDE = range(3)


@dataclass
class Target:
    """The point in a lamp that a sampled direction leads to (a PyTree of Dr.Jit).

    A sampler that returns directions alone has a distance of -inf. Only a sampler of cells has
    `cell`, `pmf` and `place`.

    Attributes:
        distance: of the point from the receiver, local units.
        cell: index of the cell of the light field that the point is in.
        pmf: probability with which this cell is sampled.
        place: where the receiver is: `OUTSIDE`, `NEAR` or `INSIDE`.
    """

    distance: "mi.Float"
    cell: "mi.UInt32"
    pmf: "mi.Float"
    place: "mi.UInt32"

    @classmethod
    def at(cls, distance: "mi.Float") -> "Target":
        """Target at a distance, of a sampler that does not sample cells."""
        return cls(distance, mi.UInt32(0), mi.Float(0), mi.UInt32(OUTSIDE))


class RayEnds(NamedTuple):
    """Where a ray through a lamp's box ends, from the point where it enters, local units.

    Attributes:
        own: mi.Float, distance of the first of the lamp's own surfaces, if they block. The cell in
            which it is counts as a whole, as it does where a point of it is sampled.
        other: mi.Float, distance of the first other surface.
    """

    own: Any
    other: Any

    def reached(self, start: Any, blocked: Any, active: Any) -> Any:
        """Whether the ray sees a cell that it enters at a distance `start` (mi.Float).

        Args:
            blocked: mi.Bool, whether the lamp's own surfaces block.
            active: mi.Bool mask.
        """
        return active & ~(blocked & (start > self.own))


class DirectionSampler(Protocol):
    """What an emitter needs of its sampler; all quantities are in the lamp's local frame.

    `EmitterSampler` documents what is not documented here.
    """

    # Whether `eval_target` and `eval_hit` return radiance times its weight of multiple importance
    # sampling, and not densities to compute the weight from.
    includes_mis = False

    def sample(self, x: Any, sample: Any, active: Any = True) -> tuple[Any, Any]: ...

    def look(self, entry: Any, direction: Any, active: Any) -> tuple[Any, Any]: ...

    def eval(
        self,
        x: Any,
        entry: Any,
        direction: Any,
        distance: Any,
        active: Any,
        target: Any = -dr.inf,
        specular_chain: Any = False,
    ) -> tuple[Any, Any, Any]: ...

    def pdf(self, x: Any, entry: Any, direction: Any, distance: Any, active: Any = True) -> Any: ...

    def sample_ray(
        self, choice: Any, sample1: Any, sample2: Any, active: Any = True
    ) -> tuple[Any, Any, Any]: ...

    def sample_target(self, x: Any, sample: Any, active: Any, inside: Any) -> tuple[Any, Target]:
        """Direction as `sample` returns it, and what `eval_target` needs of the sample.

        `inside` (mi.Bool): whether the receiver is inside the box, and gets light there.
        """
        direction, distance = self.sample(x, sample, active)
        return direction, Target.at(distance)

    def border(self, x: Any, direction: Any, target: Target, active: Any) -> Any:
        """Distance (mi.Float) within which the lamp's own surfaces block; 0 where they do not."""
        return mi.Float(0)

    def light_inside(self) -> None:
        """Prepare light for receivers inside the box."""

    def eval_target(
        self,
        x: Any,
        direction: Any,
        entry_distance: Any,
        target: Target,
        bsdf_pdf: Any,
        emitter_pmf: Any,
        active: Any,
    ) -> tuple[Any, Any]:
        """Radiance over density (mi.Color3f) of a direction of `sample_target`, and its density.

        Args:
            x: mi.Point3f, the shading point.
            direction: mi.Vector3f, unit direction from it.
            entry_distance: mi.Float, distance at which the ray enters the proxy.
            target: as `sample_target` returned it.
            bsdf_pdf: mi.Float, density per steradian with which the BSDF samples the direction.
            emitter_pmf: mi.Float, probability with which next-event estimation chooses the
                emitter.
            active: mi.Bool mask.
        """
        entry = x + entry_distance * direction
        radiance, _, density = self.eval(
            x, entry, direction, entry_distance, active, target.distance
        )
        return dr.select(density > 0, radiance / density, 0), density

    def eval_hit(
        self,
        x: Any,
        entry: Any,
        direction: Any,
        distance: Any,
        specular_chain: Any,
        bsdf_pdf: Any,
        emitter_pmf: Any,
        active: Any,
        inside: Any,
        ends: RayEnds,
    ) -> tuple[Any, Any, Any]:
        """Radiance, transmittance and density of a ray that has hit the proxy.

        Args:
            x, entry, direction, distance, specular_chain, active: as for `eval`.
            bsdf_pdf, emitter_pmf: as for `eval_target`; a probability of 0 if next-event
                estimation could not have found the direction.
            inside: as for `sample_target`.
            ends: where the ray ends in the box.
        """
        return self.eval(x, entry, direction, distance, active, specular_chain=specular_chain)


class EmitterSampler(DirectionSampler):
    """Samples directions towards a field, by its leaves and uniformly.

    Args:
        proxy: its directions are sampled uniformly if `leaves` is None.
        field: what emits.
        leaves: None for uniform sampling alone.
    """

    def __init__(self, proxy: Proxy, field: Field, leaves: LightLeaves | None) -> None:
        self._proxy, self._field, self._leaves = proxy, field, leaves
        half_extents = field.asset.frame.half_extents
        self._half = parameter(mi.Vector3f, *half_extents.tolist())
        self._radius = parameter(mi.Float, float(np.linalg.norm(half_extents)))

    def sample(self, x: Any, sample: Any, active: Any = True) -> tuple[Any, Any]:
        """Unit direction from `x` for a sample in the unit square, and its target's distance.

        Args:
            x: mi.Point3f, local frame.
            sample: mi.Point2f.
            active: mi.Bool mask.

        Returns:
            mi.Vector3f; mi.Float, distance of the sampled point, for `eval`; -inf if none.
        """
        if self._leaves is None:
            return self._proxy.sample(x, sample), mi.Float(-dr.inf)
        uniform, rest = divide_sample(sample.x, UNIFORM_FRACTION)
        sample = mi.Point2f(rest, sample.y)
        offset = self._leaves.sample(x, sample, active) - x
        target = dr.norm(offset)
        direction = dr.select(uniform, sample_cone(x, self._radius, sample), offset / target)
        return direction, dr.select(uniform, -dr.inf, target)

    def look(self, entry: Any, direction: Any, active: Any) -> tuple[Any, Any]:
        """Radiance and transmittance along rays that see the lamp, as `Field.emission`."""
        return self._field.emission(entry, direction, active)

    def eval(
        self,
        x: Any,
        entry: Any,
        direction: Any,
        distance: Any,
        active: Any,
        target: Any = -dr.inf,
        specular_chain: Any = False,
    ) -> tuple[Any, Any, Any]:
        """Radiance from a direction, and the density with which `sample` returns it.

        Args:
            x: mi.Point3f, the shading point, as `sample` was given it: on the border of what
                densities depend on, a rounded one would have another density.
            entry: mi.Point3f, where the ray enters the proxy.
            direction: mi.Vector3f, unit direction from the shading point to it.
            distance: mi.Float, from the shading point to it.
            active: mi.Bool mask.
            target: as `sample` returned it with this direction.
            specular_chain: mi.Bool, whether the radiance is for an image of the lamp. Here it is
                the same as what the lamp sends to receivers.

        Returns:
            Radiance (mi.Color3f) and transmittance of the ray; density, mi.Float per steradian, 0
            where `active` is false and where the ray is blocked before it reaches `target`.
        """
        if self._leaves is None:
            radiance, through = self._field.emission(entry, direction, active)
            return radiance, through, dr.select(active, self._proxy.pdf(x, direction), 0)
        record = self._leaves.record(x, distance)
        radiance, through, found = self._field.integrate(entry, direction, active, *record)
        return radiance, through, self._density(x, distance, target, found, active)

    def pdf(self, x: Any, entry: Any, direction: Any, distance: Any, active: Any = True) -> Any:
        """Density of `eval` alone, at about the cost of a transmittance."""
        if self._leaves is None:
            return dr.select(active, self._proxy.pdf(x, direction), 0)
        found = self._field.cross(entry, direction, active, *self._leaves.record(x, distance))
        return self._density(x, distance, -dr.inf, found, active)

    def _density(self, x, distance, target, found, active):
        of_leaves, end = found
        density = dr.lerp(of_leaves, cone_pdf(x, self._radius), UNIFORM_FRACTION)
        return dr.select(active & is_reached(target - distance, end), density, 0)

    def sample_ray(
        self, choice: Any, sample1: Any, sample2: Any, active: Any = True
    ) -> tuple[Any, Any, Any]:
        """Ray along which light leaves the lamp, and its flux.

        Args:
            choice: mi.Float in [0, 1).
            sample1, sample2: mi.Point2f in the unit square.
            active: mi.Bool mask.

        Returns:
            A point of the ray inside the proxy, the unit direction of travel, and its flux (local
            units), whose mean over all samples is the lamp's flux.
        """
        direction = mi.warp.square_to_uniform_sphere(sample1)
        areas = projected_areas(self._half, direction)
        point = point_on_box(self._half, areas, direction, sample2)
        if self._leaves is None:
            radiance, _ = self._field.emission(mi.Point3f(point), -direction, active)
            return mi.Point3f(point), direction, radiance * dr.sum(areas) * (4 * math.pi) & active
        uniform, rest = divide_sample(choice, UNIFORM_FRACTION)
        leaf_point, leaf_direction = self._leaves.sample_ray(rest, sample1, sample2)
        point = mi.Point3f(dr.select(uniform, point, leaf_point))
        direction = dr.select(uniform, direction, leaf_direction)
        record = self._leaves.record_ray(direction)
        radiance, _, found = self._field.integrate(point, -direction, active, *record)
        plain = dr.inv_four_pi / dr.sum(projected_areas(self._half, direction))
        density = dr.lerp(found[0], plain, UNIFORM_FRACTION)
        reached = uniform | is_reached(mi.Float(0), found[1])
        flux = dr.select(active & reached & (density > 0), radiance / density, 0)
        return point, direction, flux
