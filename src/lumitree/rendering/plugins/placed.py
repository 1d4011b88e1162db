"""Where a baked luminaire stands in a scene: what its emitter and its BSDF share."""

from __future__ import annotations

import copy
import functools
from typing import Any, Literal, get_args

import drjit as dr
import mitsuba as mi
import numpy as np
from numpy.typing import NDArray

from lumitree.asset.asset import Asset
from lumitree.core.arguments import check_choice
from lumitree.core.device import parameter
from lumitree.core.frames import similarity_scale
from lumitree.errors import LumitreeError
from lumitree.lamp.source import gldf_variant
from lumitree.octree.field import Field
from lumitree.octree.field_data import FieldData
from lumitree.rendering.asset_cache import open_asset, open_field
from lumitree.rendering.asset_flux import axis_intensities
from lumitree.rendering.sampling.emitter_sampling import SAMPLING_KINDS
from lumitree.rendering.sampling.proxy import BoxProxy

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
