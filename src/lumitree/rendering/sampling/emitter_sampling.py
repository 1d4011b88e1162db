"""Sampling of directions and rays in proportion to what a field emits, mixed with uniform sampling.

In the luminaire's local frame. Uniform sampling keeps every density positive where light may come
from, and bounds each sample's weight by the radiance times 4π over `UNIFORM_FRACTION`.

The density of a direction is computed along its ray, together with its radiance. Samples of
`light_leaves` may be rejected, so the density integrates to less than 1.
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal, Protocol, get_args

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.core.device import parameter
from lumitree.octree.field import Field
from lumitree.octree.traversal import Span
from lumitree.rendering.sampling.light_leaves import LightLeaves, is_reached
from lumitree.rendering.sampling.proxy import (
    BoxProxy,
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
# What is sampled: bent light (or all) of a receiver outside the box or inside; or straight light.
OUTSIDE, INSIDE, STRAIGHT = range(3)


@dataclass
class Target:
    """The point in a lamp that a sampled direction leads to (a PyTree of Dr.Jit).

    A sampler that returns directions alone has a distance of -inf. Only a sampler of cells has
    all others.

    Attributes:
        distance: of the point from the receiver, local units.
        cell: index of the cell that the point is in: of the light field, or of the light inside.
        pmf: probability with which this cell is sampled.
        place: `OUTSIDE`, `INSIDE` or `STRAIGHT`.
        bins: bin of the cell towards the receiver.
        factor: on the point's light, for the points that it was chosen of.
        light: straight light of the point, over the density with which it is sampled.
        total: estimate of the light of all points that the receiver may get, for the choice between
            bent and straight light.
        density: of the point of straight light, per steradian, for multiple importance sampling.
    """

    distance: mi.Float
    cell: mi.UInt32
    pmf: mi.Float
    place: mi.UInt32
    bins: mi.UInt32
    factor: mi.Float
    light: mi.Color3f
    total: mi.Float
    density: mi.Float

    @classmethod
    def at(cls, distance: mi.Float) -> Target:
        """Target at a distance, of a sampler that does not sample cells."""
        none, no = mi.UInt32(0), mi.Float(0)
        factor = mi.Float(1)
        return cls(distance, none, no, mi.UInt32(OUTSIDE), none, factor, mi.Color3f(0), no, no)


class DirectionSampler(Protocol):
    """Interface of an emitter's sampler; all quantities are in the lamp's local frame.

    `EmitterSampler` documents what is not documented here.
    """

    # Whether `eval_target` and `eval_hit` return radiance times its weight of multiple importance
    # sampling, and not densities to compute the weight from.
    includes_mis = False

    def sample(
        self, x: mi.Point3f, sample: mi.Point2f, active: mi.Bool | bool = True
    ) -> tuple[mi.Vector3f, mi.Float]: ...

    def look(
        self, entry: mi.Point3f, direction: mi.Vector3f, active: mi.Bool | bool
    ) -> tuple[mi.Color3f, mi.Float]: ...

    def eval(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        active: mi.Bool,
        target: mi.Float | float = -dr.inf,
        specular_chain: mi.Bool | bool = False,
        span: Span = None,
    ) -> tuple[mi.Color3f, mi.Float, mi.Float]: ...

    def pdf(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        active: mi.Bool | bool = True,
    ) -> mi.Float: ...

    def sample_ray(
        self,
        choice: mi.Float,
        sample1: mi.Point2f,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Color3f]: ...

    def sample_target(
        self, x: mi.Point3f, sample: mi.Point2f, active: mi.Bool, inside: mi.Bool
    ) -> tuple[mi.Vector3f, Target]:
        """Direction as `sample` returns it, and what `eval_target` needs of the sample.

        `inside`: whether the receiver is inside the box, and gets light there.
        """
        direction, distance = self.sample(x, sample, active)
        return direction, Target.at(distance)

    def light_inside(self) -> None:
        """Prepare light for receivers inside the box."""

    def irradiance(
        self, x: mi.Point3f, n: mi.Vector3f, random: mi.PCG32, active: mi.Bool
    ) -> mi.Color3f:
        """Irradiance of receivers outside the box, as `EmittedLight.irradiance`.

        It is by the light of targets of the place `OUTSIDE`; 0 for a sampler without
        `includes_mis`.
        """
        return mi.Color3f(0)

    def eval_target(
        self,
        x: mi.Point3f,
        direction: mi.Vector3f,
        entry_distance: mi.Float,
        target: Target,
        bsdf_pdf: mi.Float,
        emitter_pmf: mi.Float,
        active: mi.Bool,
    ) -> tuple[mi.Color3f, mi.Float]:
        """Radiance over density of a direction of `sample_target`, and its density.

        Args:
            entry_distance: distance at which the ray enters the proxy.
            bsdf_pdf: density per steradian with which the BSDF samples the direction.
            emitter_pmf: probability with which next-event estimation chooses the emitter.
        """
        entry = x + entry_distance * direction
        radiance, _, density = self.eval(
            x, entry, direction, entry_distance, active, target.distance
        )
        return dr.select(density > 0, radiance / density, 0), density

    def eval_hit(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        specular_chain: mi.Bool,
        bsdf_pdf: mi.Float,
        emitter_pmf: mi.Float,
        active: mi.Bool,
        inside: mi.Bool,
        end: mi.Float,
    ) -> tuple[mi.Color3f, mi.Float, mi.Float]:
        """Radiance, transmittance and density of a ray that has hit the proxy.

        Args:
            bsdf_pdf, emitter_pmf: as for `eval_target`; a probability of 0 if next-event
                estimation could not have found the direction.
            end: distance from `entry` of the first surface that is not the lamp's own.
        """
        span = mi.Float(0), end
        return self.eval(
            x, entry, direction, distance, active, specular_chain=specular_chain, span=span
        )


class EmitterSampler(DirectionSampler):
    """Samples directions towards a field, by its leaves and uniformly; uniformly if it has none."""

    def __init__(self, proxy: BoxProxy, field: Field, leaves: LightLeaves | None) -> None:
        self._proxy, self._field, self._leaves = proxy, field, leaves
        half_extents = field.asset.frame.half_extents
        self._half = parameter(mi.Vector3f, *half_extents.tolist())
        self._radius = parameter(mi.Float, float(np.linalg.norm(half_extents)))

    def sample(
        self, x: mi.Point3f, sample: mi.Point2f, active: mi.Bool | bool = True
    ) -> tuple[mi.Vector3f, mi.Float]:
        """Unit direction from `x`, and the distance of the sampled point; -inf if none."""
        if self._leaves is None:
            return self._proxy.sample(x, sample), mi.Float(-dr.inf)
        uniform, rest = divide_sample(sample.x, UNIFORM_FRACTION)
        sample = mi.Point2f(rest, sample.y)
        offset = self._leaves.sample(x, sample, active) - x
        target = dr.norm(offset)
        direction = dr.select(uniform, sample_cone(x, self._radius, sample), offset / target)
        return direction, dr.select(uniform, -dr.inf, target)

    def look(
        self, entry: mi.Point3f, direction: mi.Vector3f, active: mi.Bool | bool
    ) -> tuple[mi.Color3f, mi.Float]:
        """Radiance and transmittance along rays that see the lamp, as `Field.emission`."""
        return self._field.emission(entry, direction, active)

    def eval(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        active: mi.Bool,
        target: mi.Float | float = -dr.inf,
        specular_chain: mi.Bool | bool = False,
        span: Span = None,
    ) -> tuple[mi.Color3f, mi.Float, mi.Float]:
        """Radiance from a direction, and the density with which `sample` returns it.

        Args:
            x: the shading point, as `sample` was given it: on the border of what
                densities depend on, a rounded one would have another density.
            entry: where the ray enters the proxy.
            specular_chain: whether the radiance is for an image of the lamp. Here it is
                the same as what the lamp sends to receivers.
            span: distances from `entry` of the part of the ray that is in the scene. Default: all.

        Returns:
            Radiance and transmittance of the ray; density per steradian, 0 where
            `active` is false and where the ray is blocked before it reaches `target`.
        """
        if self._leaves is None:
            radiance, through = self._field.emission(entry, direction, active, span)
            return radiance, through, dr.select(active, self._proxy.pdf(x, direction), 0)
        record = self._leaves.record(x, distance)
        radiance, through, found = self._field.integrate(entry, direction, active, *record, span)
        return radiance, through, self._density(x, distance, target, found, active)

    def pdf(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        active: mi.Bool | bool = True,
    ) -> mi.Float:
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
        self,
        choice: mi.Float,
        sample1: mi.Point2f,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Color3f]:
        """Ray along which light leaves the lamp, as `EmittedLight.sample_ray`."""
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
