"""The emitter `lumitree` and the BSDF `lumitree_null`: a baked luminaire where it stands.

`Placed` is the pose, which both plugins share. A `DeferredEmitter` evaluates no radiance for
occluded directions. `LampLight` has its calls that cost, and `LampKinds` records them once for each
kind of lamp.
"""

from __future__ import annotations

import contextlib
import copy
import functools
from abc import ABC, abstractmethod
from collections.abc import Callable, Hashable, Iterator
from contextvars import ContextVar
from dataclasses import dataclass
from typing import Any, Literal, get_args

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_choice, check_gain
from lumitree.core.device import on_device, parameter
from lumitree.core.frames import similarity_scale
from lumitree.core.photometry import LUMENS_PER_WATT, luminance
from lumitree.errors import LumitreeError
from lumitree.lamp.source import gldf_variant
from lumitree.octree.field import Field, FieldData
from lumitree.rendering.asset_cache import open_asset, open_field
from lumitree.rendering.asset_flux import axis_intensities
from lumitree.rendering.geometry import GeometryEmitter, delta_bsdf_class, straight_light
from lumitree.rendering.lamp_sampler import (
    SAMPLING_KINDS,
    DirectionSampler,
    emitter_sampler,
    left_out_radius,
)
from lumitree.rendering.light_colour import light_colour
from lumitree.rendering.objects import complete_later
from lumitree.rendering.sampling import STRAIGHT, BoxProxy, Target, mis_weight
from lumitree.rendering.straight_light import StraightLight

Appearance = Literal["field", "geometry"]
APPEARANCES: tuple[Appearance, ...] = get_args(Appearance)
# A proxy around geometry is larger than its box by this part of the box's longest half-side. Else
# rays that pass the proxy would also pass surfaces that lie in its faces, as of a canopy.
GEOMETRY_MARGIN = 1e-3
# Rays of points that are nearer to a proxy may start inside of it, local units.
_TOUCH = 1e-3
_OPTIONS = ("gain", "sampling", "appearance", "to_world")


def plugin_options(props: mi.Properties) -> dict[str, Any]:
    """Arguments of `describe_proxy` from plugin properties, which need a file name."""
    options = {name: props[name] for name in _OPTIONS if name in props}
    if "to_world" in options:
        options["to_world"] = np.array(options["to_world"].matrix)
    if "filename" not in props:
        raise LumitreeError(
            "plugin 'lumitree' needs a 'filename': a .lumitree asset or a photometric file"
        )
    # Looked up relative to the scene file, as Mitsuba does.
    path, variant = gldf_variant(props["filename"])
    found = str(mi.file_resolver().resolve(path))
    return {"asset": found if variant is None else f"{found}#{variant}", **options}


def check_kinds(sampling: str, appearance: str) -> None:
    """Refuse a sampling or an appearance that there is not."""
    check_choice("sampling", sampling, SAMPLING_KINDS)
    check_choice("appearance", appearance, APPEARANCES)


def shows_geometry(asset: FieldData, appearance: Appearance) -> bool:
    """Whether images show the luminaire itself."""
    return appearance == "geometry" and isinstance(asset, Asset) and asset.geometry is not None


class Placed:
    """Members that the emitter and the BSDF share: a field, its proxy and where they stand."""

    def __init__(self, props: mi.Properties) -> None:
        options = plugin_options(props)
        self.asset = asset = open_asset(options["asset"])
        self.field = open_field(asset)
        self.sampling = options.get("sampling", "emission")
        appearance = options.get("appearance", "field")
        check_kinds(self.sampling, appearance)
        self.proxy = BoxProxy(asset.frame.half_extents)
        self.shows_geometry = shows_geometry(asset, appearance)
        # Whether something else of the scene is in the box, and gets light there.
        self.holds = False
        # Of the geometry: numbers of the shapes and of the media that scatter
        # (`objects.shape_number` and `medium_number`).
        self.own_shapes: list[int] = []
        self.own_media: list[int] = []
        scene_from_local = options.get("to_world", np.eye(4)) @ asset.frame.world_from_local
        scale = similarity_scale(scene_from_local, "to_world")
        self._scale, self._origin = scale, scene_from_local[:3, 3]
        self._axes = scene_from_local[:3, :3] / scale
        # Absolute intensities stay at any size: the radiance falls with the area.
        self._dimming = (asset.frame.scale / scale) ** 2 if asset.is_photometric else 1.0
        self.dimming = parameter(mi.Float, self._dimming)
        half = asset.frame.half_extents + self._margin
        self._half = parameter(mi.Vector3f, *half.tolist())
        self._near = parameter(mi.Vector3f, *(half + _TOUCH).tolist())
        self.scale = mi.Float(scale)
        self._centre = mi.Point3f(self._origin)
        self._rotation = mi.Matrix3f(self._axes)
        # Opaque: moving a luminaire does not compile new kernels.
        dr.make_opaque(self.scale, self._centre, self._rotation)

    def moved(self, scale: mi.Float, centre: mi.Point3f, rotation: mi.Matrix3f) -> Placed:
        """The same elsewhere on the device: scale, centre and rotation from the local frame."""
        other = copy.copy(self)
        other.scale, other._centre, other._rotation = scale, centre, rotation
        return other

    @property
    def numbers(self) -> NDArray[np.float64]:
        """Scale, centre and rotation by rows [13], as for `moved`."""
        return np.array([self._scale, *self._origin, *self._axes.ravel()])

    @property
    def _margin(self) -> float:
        """By which the proxy is larger than the box, local."""
        return GEOMETRY_MARGIN if self.shows_geometry else 0.0

    def unit_proxy(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """M [3, 3] and c [3]; M (p - c) of a point p of the scene is in [-1, 1]³ in the proxy."""
        side = self._scale * (self.asset.frame.half_extents + self._margin)
        return self._axes.T / side[:, None], self._origin

    @property
    def traces_straight_light(self) -> bool:
        """Whether its straight light is that of its own emitters, and not of the light field."""
        light_field = self.asset.light_field
        stored = light_field is None or not light_field.has_straight_light
        return self.shows_geometry and not stored and self.sampling == "emission"

    @property
    def dims(self) -> bool:
        """Whether its field takes away light of what is behind it."""
        return not self.shows_geometry and self.asset.num_leaves > 0

    @property
    def shadow_field(self) -> Field:
        """Field whose transmittance shadow rays get: of less detail beside a light field."""
        return self.field if self.asset.light_field is None else self.field.coarse

    def receiver(self, point: mi.Point3f) -> mi.Point3f:
        """A point of the local frame where it gets the light that leaves the box.

        An object that touches the box, such as the table below a lamp, may be a little inside of
        it. It gets the light of the nearest point outside. Points get it where they are if the box
        holds things.
        """
        if self.holds:
            return point
        depth = self._half - dr.abs(point)
        face = depth == dr.min(depth)
        outside = dr.select(face, dr.mulsign(self._half * (1 + 1e-5), mi.Vector3f(point)), point)
        return dr.select(self.in_box(point), mi.Point3f(outside), point)

    def touches(self, point: mi.Point3f) -> mi.Bool:
        """Whether a point of the local frame is in the box, or rays from there may start in it."""
        return dr.all(dr.abs(point) <= self._near)

    def in_box(self, point: mi.Point3f) -> mi.Bool:
        """Whether a point of the local frame is inside the box, with the margin of its geometry."""
        return dr.all(dr.abs(point) <= self._half)

    @property
    def scene_from_box(self) -> NDArray[np.float64]:
        """Transform [4, 4] of [-1, 1]³ into the scene, as the box."""
        matrix = np.eye(4)
        matrix[:3, :3] = self._scale * self._axes * self.asset.frame.half_extents
        matrix[:3, 3] = self._origin
        return matrix

    @functools.cached_property
    def axis_intensities(self) -> NDArray[np.float64]:
        """Luminous intensity [6] towards x, y and z of the scene and against them, without gain."""
        # The scene's axes in the local frame are the rows of the rotation from it.
        return axis_intensities(self.asset, self._axes) * self._dimming * self._scale**2

    @property
    def sphere(self) -> tuple[NDArray[np.float64], float]:
        """Centre [3] and radius of a sphere around the box, scene."""
        return self._origin, self._scale * float(np.linalg.norm(self.asset.frame.half_extents))

    def entering_line(
        self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool
    ) -> tuple[tuple[mi.Point3f, mi.Vector3f], mi.Bool]:
        """Local line of what looks at an interaction with the proxy, and where it enters there."""
        line = self.local_line(si.p, -si.to_world(si.wi))
        return line, active & (mi.Frame3f.cos_theta(si.wi) > 0)

    def entry(self, ray: mi.Ray3f, distance: mi.Float) -> tuple[mi.Point3f, mi.Vector3f]:
        """Where a ray of the scene enters the proxy, and its direction, as `local_line`."""
        origin, direction = self.local_line(ray.o, ray.d)
        return origin + distance / self.scale * direction, direction

    def local_line(
        self, point: mi.Point3f, direction: mi.Vector3f
    ) -> tuple[mi.Point3f, mi.Vector3f]:
        """A point of a scene line and its unit direction of travel, in the local frame."""
        return self.local_point(point), self.local_direction(direction)

    def local_point(self, point: mi.Point3f) -> mi.Point3f:
        """A scene point in the local frame."""
        # The centre first: the difference of two points near each other is exact, however far from
        # the origin they are. A matrix with a translation adds rounded products that cancel.
        return mi.Point3f(self._rotation.T @ (point - self._centre) / self.scale)

    def local_direction(self, direction: mi.Vector3f) -> mi.Vector3f:
        """A direction of the scene in the local frame, unit length."""
        return dr.normalize(self._rotation.T @ direction)

    def scene_point(self, point: mi.Point3f) -> mi.Point3f:
        """A point of the local frame in the scene."""
        return self._centre + mi.Point3f(self.scale * (self._rotation @ point))

    def scene_direction(self, direction: mi.Vector3f) -> mi.Vector3f:
        """A direction of the local frame in the scene, unit length."""
        return mi.Vector3f(dr.normalize(self._rotation @ direction))


@dataclass
class EmitterSample:
    """A direction sampled towards an emitter by next-event estimation (a PyTree of Dr.Jit).

    Attributes:
        ds: the direction and its end; its `pdf` is of no use before `eval_target`. `delta` is as
            Mitsuba has it: rays sampled by BSDFs do not find this light.
        weight: radiance over density; `eval_target` of a `DeferredEmitter` replaces it.
        valid: whether a direction was sampled.
        includes_mis: whether the weight that `eval_target` returns includes the weight of multiple
            importance sampling.
        target: the sampled point in a lamp.
        beyond: how far the shadow ray goes on beyond `ds.p`, through the lamp's own surfaces.
    """

    ds: mi.DirectionSample3f
    weight: mi.Spectrum
    valid: mi.Bool
    includes_mis: mi.Bool
    target: Target
    beyond: mi.Float


class DeferredEmitter(ABC):
    """An emitter on a see-through proxy, whose radiance and density cost a traversal.

    `mi.Emitter` returns a direction together with its radiance, so that the radiance is computed
    for directions that turn out to be occluded; and it returns radiance, transmittance and density
    in three calls that make the same traversal. An integrator that knows this protocol saves both.
    Emitters that do not follow it are used through `mi.Emitter` alone. All quantities are those of
    the methods of `mi.Emitter` and `mi.BSDF` that are named.

    A class follows it if it has the methods. It is no `typing.Protocol`, for which Python looks at
    each emitter of a large scene again.

    Attributes:
        placed: its proxy, and where it stands.
    """

    placed: Placed

    @classmethod
    def __subclasshook__(cls, kind: type) -> bool:
        return all(hasattr(kind, name) for name in ("light", "sample_target", "eval_entered"))

    @abstractmethod
    def light(self) -> Any:
        """The `LampLight` of its methods that cost."""

    @abstractmethod
    def light_inside(self) -> None:
        """Light what is in the box from now on, if it can (`placed.holds`)."""

    @abstractmethod
    def axis_intensities(self) -> NDArray[np.float64]:
        """Luminous intensity [6] towards x, y and z of the scene and against them, smoothed."""

    @abstractmethod
    def sampled_alone_radius(self) -> float:
        """Radius of `divided_sampling.left_out`, scene; 0 where rays of a BSDF always count.

        Rays for which `left_out` is true get neither light from the lamp nor are they attenuated.
        """

    @abstractmethod
    def is_summed(self, point: mi.Point3f, active: mi.Bool) -> mi.Bool:
        """Whether `irradiance` has the stored light that receivers at points of the scene get."""

    @abstractmethod
    def irradiance(
        self, point: mi.Point3f, n: mi.Vector3f, random: mi.PCG32, active: mi.Bool
    ) -> mi.Color3f:
        """Irradiance by stored light that nothing in the scene shadows, without sampled directions.

        Straight light that is traced is not in it. Points and unit normals are in the scene. Only
        receivers of `is_summed` may be active.
        """

    @abstractmethod
    def sample_target(
        self, it: mi.Interaction3f, sample: mi.Point2f, own: mi.Bool, active: mi.Bool
    ) -> EmitterSample:
        """First half of `sample_direction`: a direction to stored light, or to the lamp's emitters.

        From vertices on the lamp's `own` surfaces, and in its media, it leads to the emitters.
        """

    @abstractmethod
    def eval_target(
        self,
        it: mi.Interaction3f,
        sampled: EmitterSample,
        bsdf_pdf: mi.Float,
        emitter_pmf: mi.Float,
        active: mi.Bool,
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Second half of `sample_direction`: what a sampled direction is worth.

        Args:
            bsdf_pdf: density per steradian with which the BSDF samples the direction.
            emitter_pmf: probability with which this emitter was chosen.

        Returns:
            Radiance over density; and density per steradian, 0 where the sampled point turns out to
            be hidden within the luminaire.
        """

    @abstractmethod
    def eval_entered(
        self,
        ray: mi.Ray3f,
        distance: mi.Float,
        it: mi.Interaction3f,
        specular_chain: mi.Bool,
        bsdf_pdf: mi.Float,
        emitter_pmf: mi.Float,
        end: mi.Float,
        active: mi.Bool,
    ) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
        """`eval`, `eval_null_transmission` and `pdf_direction` in one traversal.

        Args:
            distance: from its origin to the proxy.
            it: the vertex that the ray comes from.
            specular_chain: whether all vertices between the camera and the ray are specular, so
                that the ray belongs to an image of the emitter.
            bsdf_pdf: density per steradian with which the BSDF sampled the ray.
            emitter_pmf: probability with which next-event estimation chooses this emitter; 0 if it
                could not have found the ray.
            end: distance from the ray's origin of the first surface that does not belong to the
                emitter's lamp.

        Returns:
            Radiance; transmittance; and density with which `sample_direction` gives this direction
            from `it`, 0 if the radiance includes the weight of multiple importance sampling.
        """

    @abstractmethod
    def transmittance(self, ray: mi.Ray3f, distance: mi.Float, active: mi.Bool) -> mi.Float:
        """Transmittance for a shadow ray that enters the proxy.

        Its part behind the end of the ray does not count.
        """


class LampLight:
    """Light of a baked luminaire, or of many that differ only by where they stand and by `gain`.

    Its methods are the methods of `DeferredEmitter`.
    """

    def __init__(
        self,
        placed: Placed,
        sampler: DirectionSampler,
        straight: StraightLight | None,
        light_colour: Callable[..., Any],
        gain: mi.Color3f,
    ) -> None:
        self.placed, self.sampler, self.straight = placed, sampler, straight
        self.light_colour, self.gain = light_colour, gain

    def moved(
        self, scale: mi.Float, centre: mi.Point3f, rotation: mi.Matrix3f, gain: mi.Color3f
    ) -> LampLight:
        """The same light elsewhere; arguments as of `Placed`, one for each ray."""
        placed = self.placed.moved(scale, centre, rotation)
        return LampLight(placed, self.sampler, self.straight, self.light_colour, gain)

    def sample_target(self, it, sample, own, active):
        placed = self.placed
        at = placed.local_point(it.p)
        x = placed.receiver(at)
        inside = placed.in_box(x) if placed.holds else mi.Bool(False)
        direction, target = self.sampler.sample_target(x, sample, active & ~own, inside)
        straight = mi.Bool(False)
        if self.straight is not None:
            traced = active & (own | self.placed.traces_straight_light)
            target.total = dr.select(own, 0, target.total)
            self.straight.choose(at, sample, target, traced, inside | own)
            straight = traced & (target.place == STRAIGHT)
            found = self.straight.sample(at, target, sample, straight)
            direction = dr.select(straight, found, direction)
        ds, valid = self.towards(it, x, direction, active & ~own)
        # From where the light leaves the box it is there already.
        moved = mi.Bool(False) if placed.holds else placed.in_box(at)
        end, beyond = dr.select(moved, 0, ds.dist), mi.Float(0)
        point = target.distance * placed.scale
        if placed.holds:
            valid |= active & inside & ~own
            if placed.shows_geometry:
                # The lamp's own surfaces do not block what is stored.
                end = dr.select(inside, 0, end)
                beyond = dr.maximum(point - end, 0)
            else:
                end = point
        end, beyond = dr.select(straight, point, end), dr.select(straight, 0, beyond)
        ds.p = dr.select(ds.dist == end, ds.p, dr.fma(end, ds.d, it.p))
        ds.dist = end
        valid = dr.select(straight, dr.max(target.light) > 0, valid)
        includes_mis = mi.Bool(self.sampler.includes_mis) | straight
        return EmitterSample(ds, mi.Spectrum(1), valid, includes_mis, target, beyond)

    def eval_target(self, it, sampled, bsdf_pdf, emitter_pmf, active):
        x, direction = self.placed.local_line(it.p, sampled.ds.d)
        target = sampled.target
        share = mis_weight(target.density * emitter_pmf, bsdf_pdf)
        near = sampled.ds.dist / self.placed.scale
        if not self.placed.holds:
            # Rays of the BSDF of a receiver that touches the box may not enter it.
            bsdf_pdf = dr.select(self.placed.touches(x), 0, bsdf_pdf)
            x = self.placed.receiver(x)
        straight = active & (target.place == STRAIGHT)
        weight, density = self.sampler.eval_target(
            x, direction, near, target, bsdf_pdf, emitter_pmf, active & ~straight
        )
        weight = dr.select(straight, target.light * share, weight)
        density = dr.select(straight, 1, density)
        return self.light_colour(self.gain * weight, it.wavelengths), density

    def eval_entered(self, ray, distance, it, specular_chain, bsdf_pdf, emitter_pmf, end, active):
        placed = self.placed
        x, (entry, direction) = placed.local_point(it.p), placed.entry(ray, distance)
        if placed.shows_geometry:
            # Images show the geometry's own shapes, which also hide what is behind them.
            active &= ~specular_chain
        inside = mi.Bool(False)
        if placed.holds:
            inside = placed.in_box(x)
        else:
            # Next-event estimation alone finds the light for receivers that touch the box.
            active &= (emitter_pmf <= 0) | ~placed.touches(x)
        radiance, through, density = self.sampler.eval_hit(
            x,
            entry,
            direction,
            dr.norm(entry - x),
            specular_chain,
            bsdf_pdf,
            emitter_pmf,
            active,
            inside,
            (end - distance) / placed.scale,
        )
        if not placed.dims:
            through = mi.Float(1)
        radiance = self.light_colour(self.gain * radiance, ray.wavelengths)
        return radiance & active, dr.select(active, through, 1), density

    def transmittance(self, ray, distance, active):
        if not self.placed.dims:
            return mi.Float(1)
        placed = self.placed
        line = placed.entry(ray, distance)
        # Not of what is behind a receiver, or behind a light, in the box.
        span = mi.Float(0), (ray.maxt - distance) / placed.scale
        return dr.select(active, placed.shadow_field.transmittance(*line, active, span), 1)

    def towards(self, it, origin, direction, active):
        """Sample of a direction (local frame), without its density, and whether it is valid."""
        placed = self.placed
        distance, n, enters = placed.proxy.enter(origin, direction)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p = placed.scene_point(origin + distance * direction)
        ds.n = placed.scene_direction(n)
        # Not from the difference of both points: far from the origin they are rounded.
        ds.d = placed.scene_direction(direction)
        ds.dist = distance * placed.scale
        ds.time = it.time
        # Rays that start within a proxy do not meet it, so that next-event estimation alone finds
        # the lamp.
        ds.delta = placed.touches(placed.local_point(it.p))
        return ds, active & enters


def emitter_class() -> type:
    """Class of the emitter for the variant of Mitsuba that is set, whose base class it extends.

    It is a `DeferredEmitter`. The face where a line enters the proxy has the radiance of the whole
    line; on the face where it leaves, radiance is 0. `gain` [3] (R, G, B) multiplies all radiance
    and flux, but neither transmittance nor densities. It is a differentiable parameter of
    `mitsuba.traverse`.
    """

    class LumitreeEmitter(mi.Emitter):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.placed = Placed(props)
            # Its tables are made while the scene is loaded, and not by the first image.
            complete_later(lambda: (self.sampler, self.straight, self.light_colour))
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying
            self.gain = mi.Color3f(*check_gain(props.get("gain", 1.0)))
            self._accept_gain()

        @functools.cached_property
        def sampler(self):
            placed = self.placed
            bent = placed.traces_straight_light
            return emitter_sampler(
                placed.asset, placed.field, placed.proxy, placed.sampling, bent=bent
            )

        @functools.cached_property
        def straight(self):
            return straight_light(self.placed.asset) if self.placed.shows_geometry else None

        @functools.cached_property
        def light_colour(self):
            return light_colour(self.placed.asset)

        def light(self):
            return LampLight(
                self.placed, self.sampler, self.straight, self.light_colour, self.factor
            )

        @property
        def factor(self):
            """Factor on the radiance of the asset: `gain`, less for larger absolute light."""
            return self.gain * self.placed.dimming

        def light_inside(self):
            placed = self.placed
            if self.sampler.includes_mis:
                self.sampler.light_inside()
                placed.holds = True

        def axis_intensities(self):
            gain = np.array(dr.detach(self._accepted), np.float64).ravel()
            return self.placed.axis_intensities * float(luminance(gain) / LUMENS_PER_WATT)

        def sampled_alone_radius(self):
            placed = self.placed
            if placed.dims or not self.sampler.includes_mis or self.sampling_weight() <= 0:
                return 0.0
            return placed.numbers[0] * left_out_radius(placed.asset) * (1 + 1e-4)

        def is_summed(self, point, active):
            outside = ~self.placed.in_box(self.placed.local_point(point))
            return active & outside & self.sampler.includes_mis

        def irradiance(self, point, n, random, active):
            line = self.placed.local_line(point, n)
            return self.factor * self.sampler.irradiance(*line, random, active)

        def traverse(self, callback):
            super().traverse(callback)
            callback.put("gain", self.gain, mi.ParamFlags.Differentiable)

        def parameters_changed(self, keys=()):
            if not keys or "gain" in keys:
                self._set_gain()

        def _set_gain(self):
            """Accept the value of `gain`, or raise and return to the one before."""
            try:
                check_gain(dr.detach(self.gain))
            except LumitreeError:
                mi.set_property(self.gain, self._accepted)
                raise
            self._accept_gain()

        def _accept_gain(self):
            # Opaque: another gain does not compile new kernels.
            dr.make_opaque(self.gain)
            self._accepted = mi.Color3f(self.gain)

        def eval(self, si, active=True):
            line, entering = self.placed.entering_line(si, active)
            radiance = self.factor * self.sampler.look(*line, entering)[0]
            return self.light_colour(radiance, si.wavelengths) & entering

        def sample_target(self, it, sample, own, active):
            return self.light().sample_target(it, sample, own, active)

        def eval_target(self, it, sampled, bsdf_pdf, emitter_pmf, active):
            return self.light().eval_target(it, sampled, bsdf_pdf, emitter_pmf, active)

        def eval_entered(
            self, ray, distance, it, specular_chain, bsdf_pdf, emitter_pmf, end, active
        ):
            return self.light().eval_entered(
                ray, distance, it, specular_chain, bsdf_pdf, emitter_pmf, end, active
            )

        def transmittance(self, ray, distance, active):
            return self.light().transmittance(ray, distance, active)

        def sample_direction(self, it, sample, active=True):
            placed = self.placed
            x = placed.receiver(placed.local_point(it.p))
            direction, target = self.sampler.sample(x, sample, active)
            ds, active = self.light().towards(it, x, direction, active)
            ds.emitter = mi.EmitterPtr(self)
            # As a ray that is given by the scene has it, for `pdf_direction` to agree.
            direction, near = placed.local_direction(ds.d), ds.dist / placed.scale
            entry = x + near * direction
            # `eval` does not know whether it is for an image, so both are what an image shows.
            radiance, _, ds.pdf = self.sampler.eval(
                x, entry, direction, near, active, target, specular_chain=True
            )
            radiance = self.light_colour(self.factor * radiance, it.wavelengths)
            return ds, dr.select(ds.pdf > 0, radiance / ds.pdf, 0)

        def pdf_direction(self, it, ds, active=True):
            entry, direction = self.placed.local_line(ds.p, ds.d)
            distance = dr.norm(ds.p - it.p) / self.placed.scale
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            x = self.placed.local_point(it.p)
            return self.sampler.pdf(x, entry, direction, distance, facing)

        def eval_direction(self, it, ds, active=True):
            line = self.placed.local_line(it.p, ds.d)
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            radiance, _ = self.sampler.look(*line, facing)
            return self.light_colour(self.factor * radiance, it.wavelengths) & facing

        def sample_wavelengths(self, si, sample, active=True):
            return mi.Color0f(), self.eval(si, active)

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            if mi.is_spectral:
                raise LumitreeError(
                    "integrators that trace from the light need an RGB variant for the 'lumitree' "
                    "emitter"
                )
            placed = self.placed
            p, direction, flux = self.sampler.sample_ray(sample1, sample2, sample3, active)
            # Where the line leaves the proxy is where its reverse enters.
            distance, n, _ = placed.proxy.enter(p, -direction)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.p = placed.scene_point(p - distance * direction)
            si.n = placed.scene_direction(n)
            si.time = time
            ray = si.spawn_ray(placed.scene_direction(direction))
            return ray, self.factor * flux * dr.square(placed.scale) & active

        def sample_position(self, time, sample, active=True):
            raise LumitreeError(
                "the 'lumitree' emitter cannot be connected to a camera; set hide_emitters of the "
                "integrator that traces from the light"
            )

        def to_string(self) -> str:
            return f"LumitreeEmitter[luminaire={self.placed.field.asset.luminaire}]"

    return LumitreeEmitter


def hit_light(
    emitter: mi.Emitter | LampLight | None,
    si: mi.SurfaceInteraction3f,
    it: mi.Interaction3f,
    ds: mi.DirectionSample3f,
    shown: mi.Bool,
    straight: mi.Bool,
    active: mi.Bool,
) -> tuple[mi.Spectrum, mi.Float]:
    """Light of an emitter that a ray has hit. A ray hits no proxy, so no `DeferredEmitter`.

    Args:
        it: the vertex that the ray comes from.
        shown, straight: whether the path gets what shapes of a lamp's geometry emit, or gets it if
            the lamp's straight light is traced.

    Returns:
        Radiance; and density with which emitter sampling gives this direction.
    """
    if emitter is None or isinstance(emitter, DeferredEmitter | LampLight):
        return mi.Spectrum(0), mi.Float(0)
    if isinstance(emitter, GeometryEmitter):
        counts = shown | (straight & emitter.traced)
        radiance, pdf = emitter.eval_self_emission(si, it, ds, active & counts)
        return radiance & counts, pdf
    return emitter.eval(si, active), emitter.pdf_direction(it, ds, active)


def entered_light(
    emitter: mi.Emitter | LampLight | None,
    ray: mi.Ray3f,
    distance: mi.Float,
    it: mi.Interaction3f,
    specular_chain: mi.Bool,
    bsdf_pdf: mi.Float,
    emitter_pmf: mi.Float,
    end: mi.Float,
    active: mi.Bool,
) -> tuple[mi.Spectrum, mi.Float, mi.Float]:
    """Radiance, transmittance and density of a lamp whose proxy a ray enters."""
    if isinstance(emitter, DeferredEmitter | LampLight):
        return emitter.eval_entered(
            ray, distance, it, specular_chain, bsdf_pdf, emitter_pmf, end, active
        )
    return mi.Spectrum(0), mi.Float(1), mi.Float(0)


def entered_transmittance(
    emitter: mi.Emitter | LampLight | None, ray: mi.Ray3f, distance: mi.Float, active: mi.Bool
) -> mi.Float:
    """Transmittance of a lamp whose proxy a shadow ray enters."""
    if isinstance(emitter, DeferredEmitter | LampLight):
        return emitter.transmittance(ray, distance, active)
    return mi.Float(1)


def sample_target(
    emitter: mi.Emitter | LampLight | None,
    it: mi.Interaction3f,
    sample: mi.Point2f,
    own: mi.Bool,
    active: mi.Bool,
) -> EmitterSample:
    """Direction sampled towards an emitter; weight and density are for `eval_target` to find."""
    if isinstance(emitter, DeferredEmitter | LampLight):
        return emitter.sample_target(it, sample, own, active)
    if emitter is None:
        return dr.zeros(EmitterSample)
    ds, weight = emitter.sample_direction(it, sample, active)
    target = Target.at(mi.Float(0))
    return EmitterSample(ds, weight, ds.pdf != 0, mi.Bool(False), target, mi.Float(0))


def eval_target(
    emitter: mi.Emitter | LampLight | None,
    it: mi.Interaction3f,
    sampled: EmitterSample,
    bsdf_pdf: mi.Float,
    emitter_pmf: mi.Float,
    active: mi.Bool,
) -> tuple[mi.Spectrum, mi.Float]:
    """Weight and density of a direction of `sample_target`."""
    if isinstance(emitter, DeferredEmitter | LampLight):
        return emitter.eval_target(it, sampled, bsdf_pdf, emitter_pmf, active)
    return mi.Spectrum(sampled.weight), mi.Float(sampled.ds.pdf)


def is_summed(emitter: mi.Emitter, point: mi.Point3f, active: mi.Bool) -> mi.Bool:
    """Whether the irradiance that an emitter sends to points is known (`DeferredEmitter`)."""
    if isinstance(emitter, DeferredEmitter):
        return emitter.is_summed(point, active)
    return mi.Bool(False)


# Packets of four numbers of a lamp: scale, centre and rotation.
_PACKETS = 4
# Arrays that one kernel joins: with 1,000, LLVM compiles it for more than ten minutes.
_JOINED = 16


class LampKinds:
    """The emitters of a scene by kind; `emitters` and `pointers` are its two lists of them."""

    def __init__(self, emitters: list[mi.Emitter], pointers: mi.EmitterPtr) -> None:
        lamps = {i: each for i, each in enumerate(emitters) if isinstance(each, DeferredEmitter)}
        self._others = len(emitters) > len(lamps)
        kinds: dict[Hashable, int] = {}
        self._lights: list[LampLight] = []
        numbers = np.array(dr.reinterpret_array(mi.UInt32, pointers))
        # By the number of an emitter among all emitters of the process.
        kind_of = np.full(numbers.max(initial=0) + 1, len(lamps), np.uint32)
        rows = np.zeros((len(kind_of), 4 * _PACKETS))
        slot_of = np.zeros(len(kind_of), np.uint32)
        for slot, (index, lamp) in enumerate(lamps.items()):
            kind = kinds.setdefault(_kind(lamp), len(kinds))
            if kind == len(self._lights):
                self._lights.append(lamp.light())
            number = numbers[index]
            kind_of[number], slot_of[number] = kind, slot
            rows[number, :13] = lamp.placed.numbers
        self._apart = len(lamps) > len(kinds)
        if not self._apart:
            return
        kind_of[kind_of == len(lamps)] = len(kinds)
        self._kind_of, self._slot_of = on_device(mi.UInt32, kind_of), on_device(mi.UInt32, slot_of)
        self._rows = on_device(mi.Float, rows)
        self._gains = joined_colours([lamp.light().gain for lamp in lamps.values()])

    def call(self, function: Callable[..., Any], emitter: mi.EmitterPtr, *args: Any) -> Any:
        """As `dr.dispatch`.

        Args:
            function: of `emitter_calls`; its emitter may also be a `LampLight`, and None for lanes
                whose result is of no use.
        """
        if not self._apart:
            return dr.dispatch(emitter, function, *args)
        number = dr.reinterpret_array(mi.UInt32, emitter)
        kind = dr.gather(mi.UInt32, self._kind_of, number)
        targets = [self._target(function, light) for light in self._lights]
        return dr.switch(kind, [*targets, self._other(function)], number, emitter, *args)

    def _target(self, function: Callable[..., Any], light: LampLight) -> Callable[..., Any]:
        """The function for the lamps of one kind."""

        def call(number: mi.UInt32, emitter: mi.EmitterPtr, *args: Any) -> Any:
            packets = [
                dr.gather(mi.Vector4f, self._rows, _PACKETS * number + i) for i in range(_PACKETS)
            ]
            values = [value for packet in packets for value in packet]
            slot = dr.gather(mi.UInt32, self._slot_of, number)
            gain = dr.gather(mi.Color3f, self._gains, slot)
            centre, rotation = mi.Point3f(*values[1:4]), mi.Matrix3f(*values[4:13])
            return function(light.moved(values[0], centre, rotation, gain), *args)

        return call

    def _other(self, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function for all other emitters."""

        def record(emitter: mi.Emitter, *args: Any) -> Any:
            return function(None if isinstance(emitter, DeferredEmitter) else emitter, *args)

        def call(number: mi.UInt32, emitter: mi.EmitterPtr, *args: Any) -> Any:
            return dr.dispatch(emitter, record, *args) if self._others else function(None, *args)

        return call


def joined_colours(colours: list[mi.Color3f]) -> mi.Color3f:
    """Evaluated arrays, one after another, in one; derivatives pass through."""
    while len(colours) > 1:
        groups = [colours[i : i + _JOINED] for i in range(0, len(colours), _JOINED)]
        colours = [_concatenated(group) for group in groups]
    return colours[0]


def _concatenated(colours: list[mi.Color3f]) -> mi.Color3f:
    colour = mi.Color3f(*(dr.concat([each[i] for each in colours]) for i in range(3)))
    dr.eval(colour)
    return colour


def _kind(lamp: DeferredEmitter) -> Hashable:
    """Equal for lamps whose code is the same."""
    placed = lamp.placed
    what = id(placed.asset), id(placed.field), placed.sampling
    return *what, placed.shows_geometry, placed.holds


_LEFT_OUT: ContextVar[bool] = ContextVar("_LEFT_OUT", default=False)


@contextlib.contextmanager
def proxies_left_out() -> Iterator[None]:
    """Context in which no ray meets a proxy as a shape, so that no code is recorded for that.

    Dr.Jit records the BSDFs of all scenes in the process; the field of each lamp would take long.
    """
    token = _LEFT_OUT.set(True)
    try:
        yield
    finally:
        _LEFT_OUT.reset(token)


def null_bsdf_class() -> type:
    """Class of the BSDF for the variant of Mitsuba that is set, whose base class it extends.

    Light crosses it unbent, with the transmittance of the whole line through the proxy on the face
    where the line enters, and 1 on the face where it leaves. Where the geometry is shown, its own
    shapes take away light, and the transmittance is 1.
    """

    class LumitreeNull(delta_bsdf_class()):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.placed = Placed(props)
            flags = mi.BSDFFlags.Null | mi.BSDFFlags.FrontSide | mi.BSDFFlags.BackSide
            self.m_flags = flags
            self.m_components = [flags]

        def sample(self, ctx, si, sample1, sample2, active=True):
            enabled = active & ctx.is_enabled(mi.BSDFFlags.Null, 0)
            bs = dr.zeros(mi.BSDFSample3f)
            bs.wo = -si.wi
            bs.sampled_component = 0
            bs.sampled_type = mi.UInt32(+mi.BSDFFlags.Null)
            bs.eta = 1
            bs.pdf = dr.select(enabled, 1, 0)
            return bs, self.eval_null_transmission(si, enabled) & enabled

        def eval_null_transmission(self, si, active=True):
            if not self.placed.dims or _LEFT_OUT.get():
                return mi.Spectrum(1) & active
            line, entering = self.placed.entering_line(si, active)
            through = self.placed.field.transmittance(*line, entering)
            return mi.Spectrum(dr.select(entering, through, 1))

        def to_string(self) -> str:
            return f"LumitreeNull[luminaire={self.placed.field.asset.luminaire}]"

    return LumitreeNull
