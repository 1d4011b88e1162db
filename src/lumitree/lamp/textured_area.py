"""Area emitters with textures, which take the place of Mitsuba's in scenes that are loaded."""

from __future__ import annotations

from typing import Any

import drjit as dr
import mitsuba as mi

from lumitree.lamp.emitting_surfaces import EmittingSurfaces
from lumitree.lamp.scene_instances import referred

_PLUGIN = "lumitree_area"
# Radiance that is everywhere the same. Mitsuba's own emitter samples such surfaces by area.
_CONSTANT = ("d65", "irregular", "regular", "srgb", "uniform")
# The class of the emitter in each variant in which it is registered.
_classes: dict[str | None, type] = {}


def replace_textured_areas(state: Any) -> None:
    """Let area emitters with a texture in a mi.parser.ParserState be emitters `lumitree_area`."""
    for node in state.nodes:
        props = node.props
        if node.type == mi.ObjectType.Emitter and props.plugin_name() == "area":
            textures = (state.nodes[index].props for index in referred(props).values())
            if any(each.plugin_name() not in _CONSTANT for each in textures):
                _register()
                props.set_plugin_name(_PLUGIN)


def complete_textured_areas(scene: mi.Scene) -> None:
    """Make the tables of a scene's emitters `lumitree_area`, before a kernel uses them."""
    kind = _classes.get(mi.variant())
    for shape in scene.shapes():
        if kind is not None and isinstance(emitter := shape.emitter(), kind):
            emitter.complete(shape)


def _register() -> None:
    if mi.variant() not in _classes:
        _classes[mi.variant()] = _emitter_class()
        mi.register_emitter(_PLUGIN, _classes[mi.variant()])


def _emitter_class() -> type:
    """Class of the emitter for the variant of Mitsuba that is set, whose base class it extends."""

    class LumitreeArea(mi.Emitter):
        """`area`, sampled as `EmittingSurfaces` samples."""

        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self._radiance = props.get_emissive_texture("radiance")
            # Without, as in a scene that could not be created, nothing is sampled.
            self._surfaces: EmittingSurfaces | None = None
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def complete(self, shape: mi.Shape) -> None:
            self._surfaces = EmittingSurfaces([shape], lambda si, _: self.eval(si))

        def eval(self, si, active=True):
            front = mi.Frame3f.cos_theta(si.wi) > 0
            return dr.select(front, self._radiance.eval(si, active & front), 0)

        def sample_direction(self, it, sample, active=True):
            if self._surfaces is None:
                return dr.zeros(mi.DirectionSample3f), mi.Spectrum(0)
            point = self._surfaces.sample(sample, active)
            ds, pdf = point.towards(it)
            weight = dr.select(pdf > 0, self.eval(point.si, active) / pdf, 0)
            ds.pdf = dr.select(dr.max(weight) > 0, self.pdf_direction(it, ds, active), 0)
            return ds, weight

        def pdf_direction(self, it, ds, active=True):
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            return dr.select(facing, self.get_shape().pdf_direction(it, ds, facing), 0)

        def eval_direction(self, it, ds, active=True):
            si = mi.SurfaceInteraction3f(ds, it.wavelengths)
            si.wi = mi.Vector3f(0, 0, -dr.dot(ds.d, ds.n))
            return self.eval(si, active)

        def sample_wavelengths(self, si, sample, active=True):
            if not mi.is_spectral:
                return mi.Color0f(), self.eval(si, active)
            shifts = [sample + i / dr.size_v(mi.Spectrum) for i in range(dr.size_v(mi.Spectrum))]
            return self._radiance.sample_spectrum(
                si, mi.Spectrum([each - dr.floor(each) for each in shifts]), active
            )

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            if self._surfaces is None:
                return dr.zeros(mi.Ray3f), mi.Spectrum(0)
            point = self._surfaces.sample(sample2, active)
            si, local = point.si, mi.warp.square_to_cosine_hemisphere(sample3)
            si.wi, si.time = local, time
            si.wavelengths, weight = self.sample_wavelengths(si, sample1, active)
            weight = dr.select(point.density > 0, weight * dr.pi / point.density, 0)
            return si.spawn_ray(si.to_world(local)), weight

        def sample_position(self, time, sample, active=True):
            # For light tracing, where it connects the surface with the camera.
            ps = self.get_shape().sample_position(time, sample, active)
            return ps, dr.select(ps.pdf > 0, dr.rcp(ps.pdf), 0)

        def traverse(self, callback):
            callback.put("radiance", self._radiance, mi.ParamFlags.Differentiable)

        def to_string(self) -> str:
            return f"LumitreeArea[radiance={self._radiance}]"

    return LumitreeArea
