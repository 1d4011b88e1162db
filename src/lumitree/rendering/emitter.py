"""The emitter `lumitree`: a baked luminaire at its place in a scene.

`PlacedAsset` is the pose, which the emitter and the BSDF share, and `PlacedLamp` is the light. Its
methods are the interface by which `lumitree_path` uses all emitters. `mi.Emitter` returns a
direction together with its radiance, so that the radiance of occluded directions is computed too,
and it returns radiance, transmittance and density in three calls that make the same traversal.
`PlacedLamp` saves both; `OtherEmitter` is an emitter of Mitsuba by the same methods.
"""

from __future__ import annotations

import copy
import functools
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Literal, get_args

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_choice, check_gain
from lumitree.core.device import concatenate, on_device, parameter
from lumitree.core.frames import similarity_scale
from lumitree.core.photometry import LUMENS_PER_WATT, luminance
from lumitree.errors import LumitreeError
from lumitree.lamp.source import gldf_variant
from lumitree.octree.field import Field
from lumitree.octree.traversal import Span
from lumitree.rendering.asset_cache import open_asset
from lumitree.rendering.asset_flux import axis_intensities
from lumitree.rendering.device import DeviceAsset
from lumitree.rendering.device_light import CellLight, DeviceLight
from lumitree.rendering.geometry import GeometryEmitter, move_geometry
from lumitree.rendering.objects import complete_later
from lumitree.rendering.sampling import INSIDE, OUTSIDE, STRAIGHT, Target, cone_pdf, mis_weight
from lumitree.rendering.straight_light import StraightLight

Appearance = Literal["field", "geometry"]
APPEARANCES: tuple[Appearance, ...] = get_args(Appearance)
Sampling = Literal["emission", "uniform"]
SAMPLING_KINDS: tuple[Sampling, ...] = get_args(Sampling)
# A proxy around geometry is larger than its box by this part of the box's longest half-side. Else
# rays that pass the proxy would also pass surfaces that lie in its faces, as of a canopy.
GEOMETRY_MARGIN = 1e-3
# Rays of points that are nearer to a proxy may start inside of it, local units.
_TOUCH = 1e-3
# Where the BSDF's density is below this part of a uniform density over the lamp's bounding sphere,
# next-event estimation alone finds the light. The sphere is enlarged by the second number, and
# within it this is never so: there the distance to a sampled point may be small.
_CUTOFF, _CUTOFF_RADIUS = 0.5, 1.25
# Packets of four numbers of a lamp's pose (`PlacedAsset.numbers`).
_PACKETS_OF_POSE = 4
# Arrays that one kernel joins: with 1,000, LLVM compiles it for more than ten minutes.
_JOINED = 16
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
    """Refuse an unknown sampling or appearance."""
    check_choice("sampling", sampling, SAMPLING_KINDS)
    check_choice("appearance", appearance, APPEARANCES)


def shows_geometry(asset: Asset, appearance: Appearance) -> bool:
    """Whether images show the luminaire itself."""
    return appearance == "geometry" and asset.geometry is not None


class PlacedAsset:
    """An asset and its proxy at a pose.

    Attributes:
        lights_inside: whether objects of the scene are in the box, and get light there.
        has_receivers: whether points in the box get light there, too, which are no objects.
        shape_numbers, medium_numbers: of the geometry's shapes and its media that scatter
            (`objects.shape_number`, `medium_number`).
    """

    def __init__(self, props: mi.Properties) -> None:
        options = plugin_options(props)
        self.asset = asset = open_asset(options["asset"])
        self.device = DeviceAsset(asset)
        self.field, self.proxy = self.device.field, self.device.box
        self.sampling: Sampling = options.get("sampling", "emission")
        appearance = options.get("appearance", "field")
        check_kinds(self.sampling, appearance)
        self.shows_geometry = shows_geometry(asset, appearance)
        self.lights_inside = self.has_receivers = False
        self.shape_numbers: list[int] = []
        self.medium_numbers: list[int] = []
        self._margin = GEOMETRY_MARGIN if self.shows_geometry else 0.0
        half = asset.frame.half_extents + self._margin
        self._half = parameter(mi.Vector3f, *half.tolist())
        self._near = parameter(mi.Vector3f, *(half + _TOUCH).tolist())
        self.place(options.get("to_world", np.eye(4)))

    def place(self, scene_from_world: NDArray[np.float64]) -> None:
        """Stand where a similarity [4, 4] takes the luminaire from the frame of its file.

        Raises:
            LumitreeError: it is no similarity; the pose stays.
        """
        frame = self.asset.frame
        scene_from_local = scene_from_world @ frame.world_from_local
        scale = similarity_scale(scene_from_local, "to_world")
        axes, origin = scene_from_local[:3, :3] / scale, scene_from_local[:3, 3]
        # Absolute intensities stay at any size: the radiance falls with the area.
        dimming = (frame.scale / scale) ** 2 if self.asset.is_photometric else 1.0
        # Scale, origin, axes by rows, and dimming [14].
        self.numbers = np.array([scale, *origin, *axes.ravel(), dimming])
        self.scene_from_world = scene_from_world
        self._scale, self._origin, self._axes = scale, origin, axes
        # Parameters: moving a luminaire does not compile new kernels.
        self._move([parameter(mi.Float, number) for number in self.numbers.tolist()])

    def _move(self, numbers: Sequence[mi.Float]) -> None:
        """Stand at a pose of other `numbers` on the device."""
        self._placed = list(numbers)
        self.scale, self._centre = numbers[0], mi.Point3f(*numbers[1:4])
        self._rotation, self._dimming = mi.Matrix3f(*numbers[4:13]), numbers[13]

    def unit_proxy(self) -> tuple[NDArray[np.float64], NDArray[np.float64]]:
        """M [3, 3] and c [3]; M (p - c) of a point p of the scene is in [-1, 1]³ in the proxy."""
        side = self._scale * (self.asset.frame.half_extents + self._margin)
        return self._axes.T / side[:, None], self._origin

    @property
    def scene_from_box(self) -> NDArray[np.float64]:
        """Transform [4, 4] of [-1, 1]³ into the scene, as the box."""
        matrix = np.eye(4)
        matrix[:3, :3] = self._scale * self._axes * self.asset.frame.half_extents
        matrix[:3, 3] = self._origin
        return matrix

    @property
    def sphere(self) -> tuple[NDArray[np.float64], float]:
        """Centre [3] and radius of a sphere around the box, scene."""
        return self._origin, self._scale * float(np.linalg.norm(self.asset.frame.half_extents))

    @property
    def attenuates(self) -> bool:
        """Whether its field attenuates light that comes from behind it."""
        return not self.shows_geometry and self.asset.num_leaves > 0

    @property
    def shadow_field(self) -> Field:
        """Field whose transmittance shadow rays get: of less detail beside a light field."""
        return self.field if self.asset.light_field is None else self.device.coarse_field

    def receiver(self, point: mi.Point3f) -> mi.Point3f:
        """A point of the local frame where it gets the light that leaves the box.

        An object that touches the box, such as the table below a lamp, may be a little inside of
        it. It gets the light of the nearest point outside. If the lamp lights objects in its box,
        points get it where they are.
        """
        if self.lights_inside:
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

    def entering_line(
        self, si: mi.SurfaceInteraction3f, active: mi.Bool | bool
    ) -> tuple[tuple[mi.Point3f, mi.Vector3f], mi.Bool]:
        """Local line that meets an interaction with the proxy, and whether it enters there."""
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
        ds: the direction and its end. `pdf` is set for emitters of Mitsuba alone. `delta` is as
            Mitsuba has it: rays sampled by BSDFs do not find this light.
        weight: radiance over density of an emitter of Mitsuba.
        valid: whether a direction was sampled.
        target: the sampled point in a lamp.
        beyond: how far the shadow ray goes on beyond `ds.p`, through the lamp's surfaces.
    """

    ds: mi.DirectionSample3f
    weight: mi.Spectrum
    valid: mi.Bool
    target: Target
    beyond: mi.Float


class PlacedLamp(PlacedAsset):
    """The light of a baked luminaire at its pose, or of many that differ by pose and gain.

    Points and directions of its methods are in the scene. `bsdf_pdf` is the density per steradian
    with which a BSDF samples a direction, and `emitter_pmf` the probability with which next-event
    estimation chooses the emitter.

    Attributes:
        gain: [3] factors on R, G and B; a differentiable parameter of `mitsuba.traverse`.
        to_world: from the frame of the luminaire's file to the scene; likewise.
        attached: `numbers` on the device, with derivatives by `to_world`; None if it has none.
        tracked: whether its stored light has derivatives by the pose (`with_derivatives`).
    """

    tracked = False

    def __init__(self, props: mi.Properties) -> None:
        super().__init__(props)
        self.gain = mi.Color3f(*check_gain(props.get("gain", 1.0)))
        self._accept_gain()
        self.to_world = mi.Transform4f(self.scene_from_world)
        self.attached: Sequence[mi.Float] | None = None

    def make_tables(self) -> None:
        """Make the tables that the methods need."""
        _ = self.straight, self.device.outline, mi.is_spectral and self.device.spectra
        if self.stored is not None:
            _ = self.stored.table
        if self.tracked:
            _ = self.device.moments, self.lights_inside and self._inside_light()
        _ = self.device.field_rays if self.light is None else self.light.table

    def set_gain(self) -> None:
        """Accept the value of `gain`, or raise and return to the one before."""
        try:
            check_gain(dr.detach(self.gain))
        except LumitreeError:
            mi.set_property(self.gain, self._accepted)
            raise
        self._accept_gain()

    def set_pose(self) -> bool:
        """Accept the value of `to_world`, or raise and return to the one before.

        Returns:
            Whether the lamp has moved.
        """
        given = np.array(dr.detach(self.to_world).matrix, np.float64)
        matrix = given[..., 0] if given.shape == (4, 4, 1) else given
        moved = not np.array_equal(matrix, self.scene_from_world.astype(np.float32))
        tracks = dr.grad_enabled(self.to_world)
        try:
            if tracks and self.asset.light_field is None:
                raise LumitreeError(
                    "to_world has derivatives, and the asset no light field; bake it again"
                )
            if moved:
                similarity_scale(matrix, "to_world")
                self.place(matrix)
        except LumitreeError:
            mi.set_property(self.to_world, mi.Transform4f(self.scene_from_world))
            raise
        self.__dict__.pop("_axis_intensities", None)
        self.attached = self._attached_numbers() if tracks else None
        if tracks:
            self.with_derivatives()
        return moved

    def _attached_numbers(self) -> list[mi.Float]:
        """`numbers` on the device, with derivatives by `to_world`."""
        frame = self.asset.frame
        matrix = self.to_world.matrix @ mi.Matrix4f(frame.world_from_local)
        rows = [[matrix[i, j] for j in range(3)] for i in range(3)]
        scale = dr.cbrt(dr.det(mi.Matrix3f(*itertools.chain(*rows))))
        axes = [each / scale for each in itertools.chain(*rows)]
        dimming = mi.Float(self.numbers[13])
        if self.asset.is_photometric:
            dimming = dr.square(float(frame.scale) / scale)
        found = [scale, *(matrix[i, 3] for i in range(3)), *axes, dimming]
        values = [parameter(mi.Float, number) for number in self.numbers.tolist()]
        found = [dr.replace_grad(*each) for each in zip(values, found, strict=True)]
        dr.eval(found)
        return found

    @property
    def moving(self) -> PlacedLamp | None:
        """The lamp at a pose with derivatives; None where these are not asked for."""
        if self.attached is None or not dr.grad_enabled(self.attached):
            return None
        lamp = copy.copy(self)
        lamp._move(self.attached)
        return lamp

    def with_derivatives(self) -> PlacedLamp:
        """The lamp as `lumitree_path` samples it for derivatives by the pose.

        Emitter sampling alone finds all stored light, since sampled points move with the lamp:
        with the points fixed in the local frame, the light is a smooth function of the pose. The
        light field stands for straight light, too: its edges, as of a shade, would have no
        derivatives.
        """
        if self.asset.light_field is None:
            return self
        lamp = copy.copy(self)
        lamp.tracked = True
        lamp.make_tables()
        return lamp

    @property
    def attaches_gain(self) -> bool:
        """Whether its gain has derivatives, and no emitters of its shapes take it, too."""
        return dr.grad_enabled(self.gain) and not self.shows_geometry

    def _accept_gain(self) -> None:
        # Opaque: another gain does not compile new kernels.
        dr.make_opaque(self.gain)
        self._accepted = mi.Color3f(self.gain)

    @property
    def factor(self) -> mi.Color3f:
        """Factor on the radiance of the asset: `gain`, less for larger absolute light."""
        return self.gain * self._dimming

    @property
    def samples_cells(self) -> bool:
        """Whether cells of the light field are sampled, and not uniform directions."""
        emission = self.tracked or self.sampling == "emission"
        return emission and self.asset.light_field is not None

    @property
    def traces_straight_light(self) -> bool:
        """Whether its straight light comes from its shapes, and not from the light field."""
        field = self.asset.light_field
        has_straight = field is not None and field.has_straight_light
        traced = self.shows_geometry and has_straight and self.sampling == "emission"
        return traced and not self.tracked

    @property
    def stored(self) -> DeviceLight | None:
        """Light field whose cells are sampled: of the bent light, if straight light is traced."""
        if not self.samples_cells:
            return None
        return self.device.stored_light(self.traces_straight_light)

    @property
    def light(self) -> DeviceLight | None:
        """Light field for integrators that sample directions alone."""
        if self.asset.light_field is None:
            return None
        if self.samples_cells and not self.traces_straight_light:
            return self.stored
        return self.device.light

    @property
    def straight(self) -> StraightLight | None:
        """The emitters of its geometry, if images show it."""
        return self.device.straight if self.shows_geometry else None

    def colour(self, rgb: mi.Color3f, wavelengths: mi.Spectrum) -> mi.Spectrum:
        """RGB light in the colours of the variant, at wavelengths in nm if it is spectral."""
        return self.device.spectra(rgb, wavelengths) if mi.is_spectral else mi.Spectrum(rgb)

    # ---------------------- Facts ----------------------

    @functools.cached_property
    def _axis_intensities(self) -> NDArray[np.float64]:
        # The scene's axes in the local frame are the rows of the rotation from it.
        return axis_intensities(self.asset, self._axes) * self.numbers[13] * self._scale**2

    def axis_intensities(self) -> NDArray[np.float64]:
        """[6] luminous intensity towards +x, +y, +z, -x, -y, -z of the scene, smoothed."""
        gain = np.array(dr.detach(self._accepted), np.float64).ravel()
        return self._axis_intensities * float(luminance(gain) / LUMENS_PER_WATT)

    @property
    def sampled_only_radius(self) -> float:
        """Radius of `sampled_only`, scene; 0 where rays of a BSDF always count.

        Rays for which `sampled_only` is true get neither light from the lamp nor are they
        attenuated.
        """
        if self.attenuates or not self.samples_cells:
            return 0.0
        return self.sphere[1] * _CUTOFF_RADIUS * (1 + 1e-4)

    def light_inside(self, has_objects: bool) -> None:
        """Light the inside of the box if it has objects or receivers, and if cells are sampled."""
        self.lights_inside = self.samples_cells and (has_objects or self.has_receivers)
        if self.lights_inside:
            self.device.inside_light(self.traces_straight_light)

    def is_summed(self, point: mi.Point3f, active: mi.Bool) -> mi.Bool:
        """Whether `irradiance` has the stored light that receivers at points of the scene get."""
        outside = ~self.in_box(self.local_point(point))
        return active & outside & self.samples_cells

    def irradiance(
        self, point: mi.Point3f, n: mi.Vector3f, random: mi.PCG32, active: mi.Bool
    ) -> mi.Color3f:
        """Irradiance by stored light that nothing in the scene shadows, without sampled directions.

        Straight light that is traced is not in it. Only receivers of `is_summed` may be active.
        """
        if self.stored is None:
            return mi.Color3f(0)
        x, normal = self.local_line(point, n)
        return self.factor * self.stored.irradiance(x, normal, random, active)

    # ---------------------- Emitter sampling ----------------------

    def sample_target(
        self,
        it: mi.Interaction3f,
        normal: mi.Vector3f,
        sample: mi.Point2f,
        self_light: mi.Bool,
        active: mi.Bool,
    ) -> EmitterSample:
        """Sample a direction to stored light, or to the lamp's emitters; cheap.

        With `self_light`, from vertices on the lamp's surfaces and in its media, it leads to the
        emitters. `normal` is as of `EmitterSelection.sample`.
        """
        at, n = self.local_point(it.p), self._rotation.T @ normal
        x = self.receiver(at)
        inside = self.in_box(x) if self.lights_inside else mi.Bool(False)
        direction, target = self._sample_stored(x, n, sample, active & ~self_light, inside)
        straight = mi.Bool(False)
        if self.straight is not None:
            traced = active & (self_light | self.traces_straight_light)
            target.total = dr.select(self_light, 0, target.total)
            self.straight.choose(at, n, sample, target, traced, inside | self_light)
            straight = traced & (target.place == STRAIGHT)
            found = self.straight.sample(at, target, sample, straight)
            direction = dr.select(straight, found, direction)
        ds, valid = self._towards(it, x, direction, active & ~self_light)
        # A receiver in the box that was moved to the box's face is at the end of its shadow ray.
        moved = mi.Bool(False) if self.lights_inside else self.in_box(at)
        end, beyond = dr.select(moved, 0, ds.dist), mi.Float(0)
        point = target.distance * self.scale
        if self.lights_inside:
            valid |= active & inside & ~self_light
            if self.shows_geometry:
                # The lamp's surfaces do not block stored light.
                end = dr.select(inside, 0, end)
                beyond = dr.maximum(point - end, 0)
            else:
                end = point
        end, beyond = dr.select(straight, point, end), dr.select(straight, 0, beyond)
        ds.p = dr.select(ds.dist == end, ds.p, dr.fma(end, ds.d, it.p))
        ds.dist = end
        if self.tracked and (moving := self.moving):
            offset = moving._offset(it, x + target.distance * direction)
            towards = dr.select(straight, ds.d, moving.scene_direction(offset))
            ds.d = dr.replace_grad(ds.d, towards)
        valid = dr.select(straight, dr.max(target.light) > 0, valid)
        return EmitterSample(ds, mi.Spectrum(1), valid, target, beyond)

    def _offset(self, it: mi.Interaction3f, point: mi.Point3f) -> mi.Vector3f:
        """From a receiver to a point of the lamp, local frame."""
        return mi.Vector3f(point - self.receiver(self.local_point(it.p)))

    def _sample_stored(self, x, n, sample, active, inside):
        """Direction (local frame) to a point of stored light, and the point; or uniform."""
        if self.stored is None:
            return self.proxy.sample(x, sample), Target.at(mi.Float(-dr.inf))
        found = self.stored.sample_point(x, n, sample, active & ~inside, self.tracked)
        if self.lights_inside:
            light = self._inside_light()
            at = light.sample_point(x, n, sample, active & inside, self.tracked)
            found = dr.select(inside, at, found)
        return found

    def _inside_light(self) -> CellLight:
        return self.device.inside_light(self.traces_straight_light)

    def _towards(self, it, origin, direction, active):
        """Sample of a direction (local frame), without its density, and whether it is valid."""
        distance, n, enters = self.proxy.enter(origin, direction)
        ds = dr.zeros(mi.DirectionSample3f)
        ds.p = self.scene_point(origin + distance * direction)
        ds.n = self.scene_direction(n)
        # Not from the difference of both points: far from the origin they are rounded.
        ds.d = self.scene_direction(direction)
        ds.dist = distance * self.scale
        ds.time = it.time
        # Rays that start within a proxy do not meet it, so that next-event estimation alone finds
        # the lamp.
        ds.delta = self.touches(self.local_point(it.p))
        return ds, active & enters

    def eval_target(
        self,
        it: mi.Interaction3f,
        sampled: EmitterSample,
        bsdf_pdf: mi.Float,
        emitter_pmf: mi.Float,
        active: mi.Bool,
    ) -> mi.Spectrum:
        """Radiance over density of a sampled direction, times its weight of MIS."""
        x, direction = self.local_line(it.p, dr.detach(sampled.ds.d))
        target, near = sampled.target, sampled.ds.dist / self.scale
        straight = active & (target.place == STRAIGHT)
        weight = target.light * mis_weight(target.density * emitter_pmf, bsdf_pdf)
        if not self.lights_inside:
            # Rays of the BSDF of a receiver that touches the box may not enter it.
            bsdf_pdf = dr.select(self.touches(x), 0, bsdf_pdf)
            x = self.receiver(x)
        if self.tracked:
            lamp = self.moving or self
            offset = lamp._offset(it, x + target.distance * direction)
            assert self.stored is not None
            outside = active & (target.place == OUTSIDE)
            stored = self.stored.smooth_contribution(target, offset, outside)
            if self.lights_inside:
                inside = active & (target.place == INSIDE)
                stored += self._inside_light().smooth_contribution(target, offset, inside)
            return lamp.colour(lamp.factor * dr.select(straight, weight, stored), it.wavelengths)
        stored = self._eval_stored(
            x, direction, near, target, bsdf_pdf, emitter_pmf, active & ~straight
        )
        weight = dr.select(straight, weight, stored)
        return self.colour(self.factor * weight, it.wavelengths)

    def _eval_stored(self, x, direction, near, target, bsdf_pdf, emitter_pmf, active):
        if self.stored is None:
            entry = x + near * direction
            radiance, _, density = self._eval(x, entry, direction, active)
            weight = radiance / density * mis_weight(density * emitter_pmf, bsdf_pdf)
            return dr.select(density > 0, weight, 0)
        radius = self.stored.radius
        left = sampled_only(x, _CUTOFF_RADIUS * radius, bsdf_pdf)
        other = dr.select(left, 0, bsdf_pdf / (radius * emitter_pmf))
        weight = self.stored.contribution(target, other, active & (target.place == OUTSIDE))
        if self.lights_inside:
            inside = active & (target.place == INSIDE)
            weight += self._inside_light().contribution(target, other, inside)
        return weight

    # ---------------------- Rays that a BSDF has sampled ----------------------

    def eval_hit(
        self,
        si: mi.SurfaceInteraction3f,
        it: mi.Interaction3f,
        ds: mi.DirectionSample3f,
        shown: mi.Bool,
        straight: mi.Bool,
        active: mi.Bool,
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Light of an emitter that a ray has hit; 0 for a lamp, whose proxy no ray hits.

        Args:
            it: the vertex that the ray comes from.
            ds: from there to the emitter.
            shown, straight: whether the path gets the emission of shapes of a lamp's geometry, or
                gets it if the lamp's straight light is traced.

        Returns:
            Radiance; and density with which emitter sampling gives this direction.
        """
        return mi.Spectrum(0), mi.Float(0)

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
    ) -> tuple[mi.Spectrum, mi.Float]:
        """Light of a lamp whose proxy a ray enters.

        Args:
            distance: from its origin to the proxy.
            it: the vertex that the ray comes from.
            specular_chain: whether all vertices between the camera and the ray are specular, so
                that the ray belongs to an image of the lamp.
            emitter_pmf: 0 if next-event estimation could not have found the ray.
            end: distance from the ray's origin of the first surface that does not belong to the
                lamp.

        Returns:
            Radiance times its weight of MIS; and transmittance.
        """
        x, (entry, direction) = self.local_point(it.p), self.entry(ray, distance)
        if self.shows_geometry:
            # Images show the shapes of the geometry, which also hide objects behind them.
            active &= ~specular_chain
        inside = mi.Bool(False)
        if self.lights_inside:
            inside = self.in_box(x)
        else:
            # Next-event estimation alone finds the light for receivers that touch the box.
            active &= (emitter_pmf <= 0) | ~self.touches(x)
        span = mi.Float(0), (end - distance) / self.scale
        if self.stored is None:
            radiance, through, density = self._eval(
                x, entry, direction, active, specular_chain, span
            )
            radiance *= mis_weight(bsdf_pdf, density * emitter_pmf)
        else:
            radius, sampled = self.stored.radius, emitter_pmf > 0
            left = self.tracked | sampled_only(x, _CUTOFF_RADIUS * radius, bsdf_pdf)
            gets = active & ~(sampled & left)
            if self.asset.num_leaves or self.device.outline is not None:
                gets &= ~mi.Bool(specular_chain)
            inverse = dr.select(sampled, radius * emitter_pmf / bsdf_pdf, 0)
            rest = x, entry, direction, inverse, span[1]
            radiance = self.stored.received(*rest, gets & ~inside)
            if self.tracked and (moving := self.moving):
                line = moving.local_line(ray.o, ray.d)
                radiance = dr.replace_grad(
                    radiance, self.device.moments.radiance(*line, gets & ~inside)
                )
            if self.lights_inside:
                radiance += self._inside_light().received(*rest, gets & inside)
            radiance, through = self._divided(
                radiance, entry, direction, active, specular_chain, span
            )
        if not self.attenuates:
            through = mi.Float(1)
        radiance = self.colour(self.factor * radiance, ray.wavelengths)
        return radiance & active, dr.select(active, through, 1)

    def look(self, point: mi.Point3f, direction: mi.Vector3f, active: mi.Bool | bool) -> mi.Color3f:
        """Radiance of the lamp in an image, along a line of the scene.

        Its derivatives by the pose are of the light field.
        """
        line = self.local_line(point, direction)
        radiance, _ = self.device.look(*line, active, light=self.light)
        moving = self.moving
        if moving is None:
            return self.factor * radiance
        line = moving.local_line(point, direction)
        seen = self.device.moments.radiance(*line, active)
        return moving.factor * dr.replace_grad(radiance, seen)

    def transmittance(self, ray: mi.Ray3f, distance: mi.Float, active: mi.Bool) -> mi.Float:
        """Transmittance for a shadow ray that enters the proxy; without its part behind its end."""
        if not self.attenuates:
            return mi.Float(1)
        line = self.entry(ray, distance)
        span = mi.Float(0), (ray.maxt - distance) / self.scale
        return dr.select(active, self.shadow_field.transmittance(*line, active, span), 1)

    def _eval(
        self,
        x: mi.Point3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool,
        specular_chain: mi.Bool | bool = False,
        span: Span = None,
    ) -> tuple[mi.Color3f, mi.Float, mi.Float]:
        """Radiance, transmittance and density of a direction, for samplers of directions alone."""
        if self.light is None:
            radiance, through = self.field.emission(entry, direction, active, span)
            return radiance, through, dr.select(active, self.proxy.pdf(x, direction), 0)
        radiance, density = self.light.eval(x, entry, direction, active)
        if not self.samples_cells:
            density = dr.select(active, self.proxy.pdf(x, direction), 0)
        radiance, through = self._divided(radiance, entry, direction, active, specular_chain, span)
        return radiance, through, density

    def _divided(
        self,
        radiance: mi.Color3f,
        entry: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool,
        specular_chain: mi.Bool | bool,
        span: Span,
    ) -> tuple[mi.Color3f, mi.Float]:
        """Radiance and transmittance of rays.

        Images show the field or the luminous opening, receivers get `radiance`.
        """
        if not self.asset.num_leaves:
            if (outline := self.device.outline) is not None:
                seen = outline.radiance(entry, direction, active & specular_chain)
                radiance = dr.select(specular_chain, seen, radiance)
            return radiance, mi.Float(1)
        seen, through = self.field.emission(entry, direction, active & specular_chain, span)
        passed = self.shadow_field.transmittance(
            entry, direction, active & ~mi.Bool(specular_chain), span
        )
        return dr.select(specular_chain, seen, radiance), dr.select(specular_chain, through, passed)


def sampled_only(x: mi.Point3f, radius: mi.Float, bsdf_pdf: mi.Float) -> mi.Bool:
    """Whether emitter sampling alone finds the light of a direction of a BSDF.

    Emitter sampling alone finds the light of directions that the BSDF hardly ever samples, so that
    few paths need the radiance of a whole ray.

    Args:
        x: receiver, relative to the centre of the lamp.
        radius: of the enlarged bounding sphere.
        bsdf_pdf: density per steradian with which the BSDF samples the direction.
    """
    far = dr.squared_norm(mi.Vector3f(x)) > dr.square(radius)
    return far & (bsdf_pdf < _CUTOFF * cone_pdf(x, radius))


class OtherEmitter:
    """An emitter of Mitsuba by the methods of `PlacedLamp`; None where a result is of no use."""

    def __init__(self, emitter: mi.Emitter | None) -> None:
        self._emitter = emitter

    def sample_target(self, it, normal, sample, self_light, active):
        if self._emitter is None:
            return dr.zeros(EmitterSample)
        ds, weight = self._emitter.sample_direction(it, sample, active)
        return EmitterSample(ds, weight, ds.pdf != 0, Target.at(mi.Float(0)), mi.Float(0))

    def eval_target(self, it, sampled, bsdf_pdf, emitter_pmf, active):
        weight = mis_weight(sampled.ds.pdf * emitter_pmf, bsdf_pdf)
        return sampled.weight * dr.select(sampled.ds.delta, 1, weight)

    def eval_hit(self, si, it, ds, shown, straight, active):
        emitter = self._emitter
        if emitter is None:
            return mi.Spectrum(0), mi.Float(0)
        if isinstance(emitter, GeometryEmitter):
            counts = shown | (straight & emitter.traced)
            radiance, pdf = emitter.eval_self_emission(si, it, ds, active & counts)
            return radiance & counts, pdf
        return emitter.eval(si, active), emitter.pdf_direction(it, ds, active)

    def eval_entered(self, ray, distance, it, specular_chain, bsdf_pdf, emitter_pmf, end, active):
        return mi.Spectrum(0), mi.Float(1)

    def transmittance(self, ray, distance, active):
        return mi.Float(1)

    def is_summed(self, point, active):
        return mi.Bool(False)


def lamp_of(emitter: mi.Emitter | None) -> PlacedLamp | None:
    """The baked luminaire of an emitter; None for other emitters."""
    return getattr(emitter, "lamp", None)


def lamps_of(emitters: Sequence[mi.Emitter]) -> dict[int, PlacedLamp]:
    """The baked luminaires among some emitters, by index."""
    lamps = {index: lamp_of(emitter) for index, emitter in enumerate(emitters)}
    return {index: lamp for index, lamp in lamps.items() if lamp is not None}


class Instances:
    """Poses and gains of lamps on the device.

    Args:
        lamps: by the number of their emitters among all emitters of the process.
    """

    def __init__(self, lamps: Mapping[int, PlacedLamp]) -> None:
        rows = np.zeros((max(lamps) + 1, 4 * _PACKETS_OF_POSE))
        place_of = np.zeros(len(rows), np.uint32)
        for place, (number, lamp) in enumerate(lamps.items()):
            rows[number, : len(lamp.numbers)], place_of[number] = lamp.numbers, place
        self._rows, self._place_of = on_device(mi.Float, rows), on_device(mi.UInt32, place_of)
        self._gains = mi.Color3f(*joined([list(lamp.gain) for lamp in lamps.values()]))
        self._attached: Sequence[mi.Float] | None = None
        if any(lamp.moving for lamp in lamps.values()):
            self._attached = joined([lamp.attached or lamp._placed for lamp in lamps.values()])

    def of(self, lamp: PlacedLamp, number: mi.UInt32) -> PlacedLamp:
        """A lamp with the pose and the gain of the instance of a number, one for each ray."""
        packets = [
            dr.gather(mi.Vector4f, self._rows, _PACKETS_OF_POSE * number + i)
            for i in range(_PACKETS_OF_POSE)
        ]
        instance = copy.copy(lamp)
        instance._move([value for packet in packets for value in packet])
        place = dr.gather(mi.UInt32, self._place_of, number)
        instance.gain = dr.gather(mi.Color3f, self._gains, place)
        if self._attached is not None:
            instance.attached = [dr.gather(mi.Float, each, place) for each in self._attached]
        return instance


def joined(rows: list[Sequence[mi.Float]]) -> Sequence[mi.Float]:
    """Evaluated arrays of several rows, each joined over the rows; derivatives pass through."""
    while len(rows) > 1:
        groups = [rows[i : i + _JOINED] for i in range(0, len(rows), _JOINED)]
        rows = [[concatenate(each) for each in zip(*group, strict=True)] for group in groups]
        for row in rows:
            dr.eval(row)
    return rows[0]


def emitter_class() -> type:
    """Class of the emitter for the variant of Mitsuba that is set, whose base class it extends.

    The face where a line enters the proxy has the radiance of the whole line; on the face where it
    leaves, radiance is 0. The gain multiplies all radiance and flux, but neither transmittance nor
    densities.
    """

    class LumitreeEmitter(mi.Emitter):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.lamp = PlacedLamp(props)
            # Its tables are made while the scene is loaded, and not by the first image.
            complete_later(self.lamp.make_tables)
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def traverse(self, callback):
            super().traverse(callback)
            callback.put("gain", self.lamp.gain, mi.ParamFlags.Differentiable)
            kind = mi.ParamFlags.Differentiable | mi.ParamFlags.Discontinuous
            callback.put("to_world", self.lamp.to_world, kind)

        def parameters_changed(self, keys=()):
            if not keys or "gain" in keys:
                self.lamp.set_gain()
            if (not keys or "to_world" in keys) and self.lamp.set_pose():
                self.get_shape().follow(self.lamp.scene_from_world)
                move_geometry(self.lamp)

        def eval(self, si, active=True):
            entering = active & (mi.Frame3f.cos_theta(si.wi) > 0)
            radiance = self.lamp.look(si.p, -si.to_world(si.wi), entering)
            return self.lamp.colour(radiance, si.wavelengths) & entering

        def sample_direction(self, it, sample, active=True):
            lamp = self.lamp
            x = lamp.receiver(lamp.local_point(it.p))
            cells = lamp.light if lamp.samples_cells else None
            direction = (
                lamp.proxy.sample(x, sample) if cells is None else cells.sample(x, sample, active)
            )
            ds, active = lamp._towards(it, x, direction, active)
            ds.emitter = mi.EmitterPtr(self)
            # As a ray that is given by the scene has it, for `pdf_direction` to agree.
            direction = lamp.local_direction(ds.d)
            entry = x + ds.dist / lamp.scale * direction
            # `eval` does not know whether it is for an image, so both are for images.
            radiance, _, ds.pdf = lamp._eval(x, entry, direction, active, specular_chain=True)
            radiance = lamp.colour(lamp.factor * radiance, it.wavelengths)
            return ds, dr.select(ds.pdf > 0, radiance / ds.pdf, 0)

        def pdf_direction(self, it, ds, active=True):
            entry, direction = self.lamp.local_line(ds.p, ds.d)
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            x = self.lamp.local_point(it.p)
            return self.lamp._eval(x, entry, direction, facing)[2]

        def eval_direction(self, it, ds, active=True):
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            radiance = self.lamp.look(it.p, ds.d, facing)
            return self.lamp.colour(radiance, it.wavelengths) & facing

        def sample_wavelengths(self, si, sample, active=True):
            return mi.Color0f(), self.eval(si, active)

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            if mi.is_spectral:
                raise LumitreeError(
                    "integrators that trace from the light need an RGB variant for the 'lumitree' "
                    "emitter"
                )
            lamp = self.lamp
            p, direction, flux = lamp.device.sample_ray(
                sample1, sample2, sample3, active, light=lamp.light
            )
            # Where the line leaves the proxy is where its reverse enters.
            distance, n, _ = lamp.proxy.enter(p, -direction)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.p = lamp.scene_point(p - distance * direction)
            si.n = lamp.scene_direction(n)
            si.time = time
            ray = si.spawn_ray(lamp.scene_direction(direction))
            return ray, lamp.factor * flux * dr.square(lamp.scale) & active

        def sample_position(self, time, sample, active=True):
            raise LumitreeError(
                "the 'lumitree' emitter cannot be connected to a camera; set hide_emitters of the "
                "integrator that traces from the light"
            )

        def to_string(self) -> str:
            return f"LumitreeEmitter[luminaire={self.lamp.asset.luminaire}]"

    return LumitreeEmitter
