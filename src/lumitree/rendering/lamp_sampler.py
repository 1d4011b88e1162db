"""Sampling of directions and rays in proportion to what a field emits, mixed with uniform sampling.

In the luminaire's local frame. Uniform sampling keeps every density positive where light may come
from, and bounds each sample's weight by the radiance times 4π over `UNIFORM_FRACTION`.

The density of a direction is computed along its ray, together with its radiance. Samples of
`light_leaves` may be rejected, so the density integrates to less than 1.
"""

from __future__ import annotations

import math
from typing import Literal, Protocol, get_args

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.asset.asset import Asset
from lumitree.core.device import parameter
from lumitree.octree.field import Field
from lumitree.octree.traversal import Span
from lumitree.rendering.device_light import (
    DeviceLightField,
    InsideLight,
    device_light_field,
    inside_light,
)
from lumitree.rendering.light_leaves import LightLeaves, is_reached, light_leaves
from lumitree.rendering.sampling import (
    INSIDE,
    OUTSIDE,
    UNIFORM_FRACTION,
    BoxProxy,
    Target,
    cone_pdf,
    divide_sample,
    point_on_box,
    projected_areas,
    sample_cone,
)

Sampling = Literal["emission", "uniform"]
SAMPLING_KINDS: tuple[Sampling, ...] = get_args(Sampling)


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


# Where the BSDF's density is below this part of a uniform density over the lamp's bounding sphere,
# next-event estimation alone finds the light. The sphere is enlarged by the second number, and
# within it this is never so: there the distance to a sampled point may be small.
_CUTOFF, _CUTOFF_RADIUS = 0.5, 1.25


def emitter_sampler(
    asset: Asset,
    field: Field,
    proxy: BoxProxy,
    sampling: Sampling = "emission",
    bent: bool = False,
) -> DirectionSampler:
    """Sampler of what an asset emits; arguments as for `EmitterSampler` and `lumitree.shape`.

    With `bent`, what receivers get is its bent light alone, since its straight light is traced.
    """
    uniform = sampling == "uniform"
    if asset.light_field is None:
        return EmitterSampler(proxy, field, None if uniform else light_leaves(field))
    if uniform:
        return DividedSampler(asset, field, proxy)
    return CellSampler(asset, field, bent=bent)


def look(
    asset: Asset,
    field: Field,
    origin: mi.Point3f,
    direction: mi.Vector3f,
    active: mi.Bool | bool,
    *,
    parallel: bool = False,
    light: DeviceLightField | None = None,
) -> tuple[mi.Color3f, mi.Float]:
    """Radiance and transmittance of a lamp in an image, as `Field.emission`.

    An asset whose field is empty shows its light field (`light`, if it is on the device), which
    hides nothing; `parallel` as for `DeviceLightField.eval`.
    """
    if asset.light_field is None or asset.num_leaves:
        return field.emission(origin, direction, active)
    light = light or device_light_field(asset)
    radiance, _ = light.eval(origin, origin, direction, mi.Float(0), active, parallel=parallel)
    return radiance, dr.full(mi.Float, 1, dr.width(radiance))


class DividedSampler(DirectionSampler):
    """As `EmitterSampler`, for a lamp with a light field.

    Directions are sampled by the light field, or uniformly towards the proxy `uniform`. It is also
    the radiance that receivers get. Images show the field, as `look` has it.
    """

    def __init__(
        self,
        asset: Asset,
        field: Field,
        uniform: BoxProxy | None = None,
        *,
        rough: bool = False,
    ) -> None:
        self._asset, self._field, self._uniform = asset, field, uniform
        self._light = device_light_field(asset, rough=rough)

    def sample(
        self, x: mi.Point3f, sample: mi.Point2f, active: mi.Bool | bool = True
    ) -> tuple[mi.Vector3f, mi.Float]:
        """Unit direction for a sample in the unit square; no point is sampled (-inf)."""
        if self._uniform is not None:
            return self._uniform.sample(x, sample), mi.Float(-dr.inf)
        return self._light.sample(x, sample, active), mi.Float(-dr.inf)

    def look(
        self, entry: mi.Point3f, direction: mi.Vector3f, active: mi.Bool | bool
    ) -> tuple[mi.Color3f, mi.Float]:
        """Radiance and transmittance along rays of an image."""
        return look(self._asset, self._field, entry, direction, active, light=self._light)

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
        """Radiance from a direction, transmittance, and the density per steradian of `sample`."""
        radiance, density = self._eval(x, entry, direction, distance, active)
        radiance, through = self._divide(radiance, entry, direction, active, specular_chain, span)
        return radiance, through, density

    def _divide(
        self,
        radiance: mi.Color3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool,
        specular_chain: mi.Bool | bool,
        span: Span = None,
    ) -> tuple[mi.Color3f, mi.Float]:
        """Part that rays get of a radiance for receivers, and their transmittance."""
        if not self._asset.num_leaves:
            return radiance, mi.Float(1)
        seen, through = self._field.emission(entry, direction, active & specular_chain, span)
        passed = self._field.coarse.transmittance(
            entry, direction, active & ~mi.Bool(specular_chain), span
        )
        return dr.select(specular_chain, seen, radiance), dr.select(specular_chain, through, passed)

    def pdf(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        distance: mi.Float,
        active: mi.Bool | bool = True,
    ) -> mi.Float:
        """Density per steradian with which `sample` returns a direction."""
        return self._eval(x, entry, direction, distance, active)[1]

    def _eval(self, x, entry, direction, distance, active):
        radiance, density = self._light.eval(x, entry, direction, distance, active)
        if self._uniform is not None:
            density = self._uniform.pdf(x, direction)
        return radiance, dr.select(active, density, 0)

    def sample_ray(
        self,
        choice: mi.Float,
        sample1: mi.Point2f,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Color3f]:
        """Point of a ray on which light leaves the lamp, its direction of travel, and its flux."""
        return self._light.emitted.sample_ray(choice, sample1, sample2, active)


class CellSampler(DividedSampler):
    """As `DividedSampler`; next-event estimation takes the light of one cell, without a traversal.

    Multiple importance sampling is by direction and distance, so this sampler computes its weights
    (`light_field`). A direction that the BSDF hardly ever samples is left to next-event
    estimation, so that few paths need the radiance of a whole ray.
    """

    includes_mis = True

    def __init__(self, asset: Asset, field: Field, *, bent: bool = False) -> None:
        # What is bent is for `lumitree_path`, and all light for other integrators alone.
        super().__init__(asset, field, rough=bent)
        self._stored = device_light_field(asset, bent=True) if bent else self._light
        self._inside: InsideLight | None = None
        self._radius = parameter(mi.Float, float(np.linalg.norm(asset.frame.half_extents)))

    def light_inside(self) -> None:
        """Make what receivers inside the box need."""
        self._inside = inside_light(self._asset, self._stored)

    def irradiance(
        self, x: mi.Point3f, n: mi.Vector3f, random: mi.PCG32, active: mi.Bool
    ) -> mi.Color3f:
        """Irradiance of receivers outside the box that nothing shadows, without straight light."""
        return self._stored.emitted.irradiance(x, n, random, active)

    def sample_target(
        self, x: mi.Point3f, sample: mi.Point2f, active: mi.Bool, inside: mi.Bool
    ) -> tuple[mi.Vector3f, Target]:
        """Direction towards a point of a cell, and that point."""
        direction, target = self._stored.sample_point(x, sample, active & ~inside)
        if self._inside is not None:
            other_direction, other = self._inside.sample_point(x, sample, active & inside)
            direction = dr.select(inside, other_direction, direction)
            target = dr.select(inside, other, target)
        return direction, target

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
        """Light of the sampled point times its weight of multiple importance sampling.

        The density is 1 where `active`, because the weight is included.
        """
        place = target.place
        other = dr.select(self._left_out(x, bsdf_pdf), 0, bsdf_pdf / (self._radius * emitter_pmf))
        outside = active & (place == OUTSIDE)
        weight = self._stored.contribution(target, other, outside)
        if self._inside is not None:
            inside = active & (place == INSIDE)
            weight += self._inside.contribution(target, other, inside)
        return weight, dr.select(active, mi.Float(1), 0)

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
        """Light of all cells on the ray times their weights, transmittance, and a density of 0."""
        gets = active & ~((emitter_pmf > 0) & self._left_out(x, bsdf_pdf))
        if self._asset.num_leaves:
            gets &= ~mi.Bool(specular_chain)
        inverse = dr.select(emitter_pmf > 0, self._radius * emitter_pmf / bsdf_pdf, 0)
        radiance = self._stored.received(
            x, entry, direction, distance, inverse, end, gets & ~inside
        )
        if self._inside is not None:
            radiance += self._inside.received(x, entry, direction, inverse, end, gets & inside)
        span = mi.Float(0), end
        radiance, through = self._divide(radiance, entry, direction, active, specular_chain, span)
        return radiance, through, mi.Float(0)

    def _left_out(self, x, bsdf_pdf):
        """Whether a direction is left to next-event estimation."""
        return left_out(x, _CUTOFF_RADIUS * self._radius, bsdf_pdf)


def left_out(x: mi.Point3f, radius: mi.Float, bsdf_pdf: mi.Float) -> mi.Bool:
    """Whether `CellSampler` leaves a direction to next-event estimation.

    Args:
        x: receiver, relative to the centre of the lamp.
        radius: of the bounding sphere, enlarged as `left_out_radius` has it.
        bsdf_pdf: density per steradian with which the BSDF samples the direction.
    """
    far = dr.squared_norm(mi.Vector3f(x)) > dr.square(radius)
    return far & (bsdf_pdf < _CUTOFF * cone_pdf(x, radius))


def left_out_radius(asset: Asset) -> float:
    """The radius of `left_out`, local units."""
    return _CUTOFF_RADIUS * float(np.linalg.norm(asset.frame.half_extents))
