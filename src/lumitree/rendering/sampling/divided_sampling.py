"""Emission of a lamp that is divided: receivers get the light field, images show the field.

docs/decisions/light-field.md states which paths get which.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi
import numpy as np

from lumitree.asset.asset import Asset
from lumitree.core.device import parameter
from lumitree.octree.field import Field
from lumitree.octree.traversal import Span
from lumitree.rendering.sampling.emitter_sampling import (
    INSIDE,
    OUTSIDE,
    DirectionSampler,
    EmitterSampler,
    Sampling,
    Target,
)
from lumitree.rendering.sampling.light_field import DeviceLightField, device_light_field
from lumitree.rendering.sampling.light_inside import InsideLight, inside_light
from lumitree.rendering.sampling.light_leaves import light_leaves
from lumitree.rendering.sampling.proxy import BoxProxy, cone_pdf

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
