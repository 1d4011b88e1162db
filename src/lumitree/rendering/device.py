"""An asset on the device: all that its lamps share, each part made on first use."""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.asset.asset import Asset
from lumitree.asset.light_field import LightField, unpack
from lumitree.core.device import shared
from lumitree.octree.field import COARSE_DEPTH, Field, coarsened, shared_field
from lumitree.rendering.device_light import DeviceLight, InsideLight
from lumitree.rendering.field_rays import FieldRays
from lumitree.rendering.geometry import Surfaces
from lumitree.rendering.light_colour import LightSpectra, light_table
from lumitree.rendering.light_moments import LightMoments
from lumitree.rendering.outline import LuminousOutline
from lumitree.rendering.sampling import BoxProxy
from lumitree.rendering.straight_light import StraightLight


class DeviceAsset:
    """An asset, and its copies on the device, which live as long as the asset."""

    def __init__(self, asset: Asset) -> None:
        self.asset = asset

    @property
    def field(self) -> Field:
        """The radiance field."""
        return shared_field(self.asset)

    @property
    def coarse_field(self) -> Field:
        """Field of few leaves whose transmittance is about the same; beside a light field."""
        if self.asset.tree_depth <= COARSE_DEPTH:
            return self.field
        return shared(self.asset, "coarse", lambda: Field(coarsened(self.asset)))

    @property
    def box(self) -> BoxProxy:
        """Its bounding box."""
        return shared(self.asset, "box", lambda: BoxProxy(self.asset.frame.half_extents))

    @property
    def field_rays(self) -> FieldRays | None:
        """Rays of the radiance field; None if it is empty."""
        if not self.asset.num_leaves:
            return None
        return shared(self.asset, "rays", lambda: FieldRays(self.field, self.asset))

    @property
    def spectra(self) -> LightSpectra:
        """Conversion of its light to spectra."""
        return shared(self.asset, "spectra", lambda: LightSpectra(light_table(self.asset.spectrum)))

    @property
    def surfaces(self) -> Surfaces:
        """BSDFs and textures of its geometry."""
        geometry = self.asset.geometry
        assert geometry is not None
        return shared(self.asset, "surfaces", lambda: Surfaces(geometry))

    @property
    def straight(self) -> StraightLight | None:
        """The emitters of its geometry; None if nothing emits."""
        return shared(self.asset, "straight", self._straight_light)

    def _straight_light(self) -> StraightLight | None:
        asset = self.asset
        surfaces = self.surfaces.emitting(asset.frame)
        if not surfaces:
            return None
        return StraightLight(
            surfaces, asset.light_field, asset.frame.half_extents, asset.light_factors
        )

    @property
    def light(self) -> DeviceLight:
        """The light field without levels: for rays, images and directions."""
        return self.stored_light(False, levels=False)

    def stored_light(self, bent: bool, *, levels: bool = True) -> DeviceLight:
        """The light field, or its bent light, with levels, as `lumitree_path` samples it."""

        def make() -> DeviceLight:
            asset, field = self.asset, self._light_field(bent)
            rest = field, asset.frame.half_extents, asset.light_factors
            minor = bent and 2 * _brightness(field) < _brightness(self._light_field(False))
            return DeviceLight(*rest, levels=levels, minor=minor)

        return shared(self.asset, ("light", bent, levels), make)

    def _light_field(self, bent: bool) -> LightField:
        field = self.asset.light_field
        assert field is not None
        return field.bent_light if bent else field

    @property
    def moments(self) -> LightMoments:
        """The light field for derivatives by lines."""
        return shared(
            self.asset,
            "moments",
            lambda: LightMoments(
                self._light_field(False), self.asset.frame.half_extents, self.asset.light_factors
            ),
        )

    def inside_light(self, bent: bool) -> InsideLight:
        """As `stored_light`, for receivers inside the box."""

        def make() -> InsideLight:
            asset, field = self.asset, self._light_field(bent)
            outside = self.stored_light(bent)
            return InsideLight(field, asset.frame.half_extents, outside, asset.light_factors)

        return shared(self.asset, ("inside", bent), make)

    @property
    def outline(self) -> LuminousOutline | None:
        """The luminous opening that images show in place of the light field, if it has one."""
        asset, light = self.asset, self.asset.light_field
        if asset.num_leaves or light is None or light.outline is None:
            return None
        rest = light, light.outline, asset.frame.half_extents, asset.light_factors
        return shared(asset, "outline", lambda: LuminousOutline(*rest))

    def look(
        self,
        origin: mi.Point3f,
        direction: mi.Vector3f,
        active: mi.Bool | bool,
        *,
        light: DeviceLight | None = None,
        parallel: bool = False,
    ) -> tuple[mi.Color3f, mi.Float]:
        """Radiance and transmittance of the lamp in an image, as `Field.emission`.

        An asset whose field is empty shows its luminous opening or its light field, which hide
        nothing: `light`, if it is on the device with tables. `parallel` as for `DeviceLight.eval`.
        """
        if self.asset.light_field is None or self.asset.num_leaves:
            return self.field.emission(origin, direction, active)
        if self.outline is not None:
            radiance = self.outline.radiance(origin, direction, active)
        else:
            rest = origin, origin, direction, active
            radiance, _ = (light or self.light).eval(*rest, parallel=parallel)
        return radiance, dr.full(mi.Float, 1, dr.width(radiance))

    def sample_ray(
        self,
        choice: mi.Float,
        sample1: mi.Point2f,
        sample2: mi.Point2f,
        active: mi.Bool | bool = True,
        *,
        light: DeviceLight | None = None,
    ) -> tuple[mi.Point3f, mi.Vector3f, mi.Color3f]:
        """Ray along which light leaves the lamp, as `DeviceLight.sample_ray`.

        It is a ray of the light field (`light` as for `look`), or else of the radiance field.
        """
        if self.asset.light_field is not None:
            return (light or self.light).sample_ray(choice, sample1, sample2, active)
        if self.field_rays is None:
            zero = dr.zeros(mi.Vector3f, dr.width(choice))
            return mi.Point3f(zero), mi.warp.square_to_uniform_sphere(sample1), mi.Color3f(zero)
        return self.field_rays.sample_ray(choice, sample1, sample2, active)


def _brightness(field: LightField) -> float:
    """Sum of all intensities of a light field, in units of its scale."""
    return float(unpack(field.intensity).sum())
