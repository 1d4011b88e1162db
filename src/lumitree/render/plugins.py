"""The Mitsuba plugins: emitter `lumitree`, BSDF `lumitree_null` and shape `lumitree_proxy`.

(The integrator `lumitree_path` is registered here too.) All take the same properties:

    filename      the asset
    to_world      where the luminaire goes, relative to its own file's frame (default: there)
    proxy         "box" (default) or "sphere"
    min_density, max_opacity    see `lumitree.render.field.Field`; exact by default
    sampling      "emission" (default), or "uniform" over the proxy

`lumitree_proxy` is the proxy shape with both others attached: what a scene XML names. L_o =
L_e + T · L_i (Eq. 2 with D1): the emitter returns L_e, the BSDF T, both on the face where the
ray enters; on the face where it leaves they are 0 and 1.
"""

import importlib
from typing import Any

import numpy as np

from lumitree.core.backend import load_mitsuba
from lumitree.core.frames import similarity_scale
from lumitree.errors import LumitreeError

_registered: set[str] = set()


def register() -> None:
    """Register the plugins with the variant of Mitsuba that is set; harmless when repeated.

    Raises:
        LumitreeError: Mitsuba runs on an unusable libLLVM, or its variant is not RGB.
    """
    mi = load_mitsuba()
    if mi.variant() in _registered:
        return
    shape = importlib.import_module("lumitree.render.shape")
    integrator = importlib.import_module("lumitree.render.integrator").integrator_class()
    emitter, bsdf = _plugin_classes(mi)
    mi.register_emitter("lumitree", emitter)
    mi.register_bsdf("lumitree_null", bsdf)
    mi.register_integrator("lumitree_path", integrator)
    mi.register_shape("lumitree_proxy", lambda props: mi.load_dict(shape.shape(**_options(props))))
    _registered.add(mi.variant())


def _options(props: Any) -> dict[str, Any]:
    """Arguments of `lumitree.shape` from plugin properties."""
    options = {
        name: props[name]
        for name in ("min_density", "max_opacity", "proxy", "sampling", "to_world")
        if props.has_property(name)
    }
    if "to_world" in options:
        options["to_world"] = np.array(options["to_world"].matrix)
    if not props.has_property("filename"):
        raise LumitreeError("plugin 'lumitree' needs a 'filename': the .lumitree asset")
    return {"asset": resolve(props["filename"]), **options}


def resolve(filename: str) -> str:
    """Path of `filename`, looked up relative to the scene file as Mitsuba does."""
    mi = load_mitsuba()
    return str(mi.file_resolver().resolve(filename))


class Placed:
    """What the emitter and the BSDF share: a field, its proxy and where they stand."""

    def __init__(self, props: Any) -> None:
        import drjit as dr
        import mitsuba as mi

        from lumitree.render.field import open_field
        from lumitree.render.proxy import make_proxy

        options = _options(props)
        thresholds = {n: options[n] for n in ("min_density", "max_opacity") if n in options}
        self.field = open_field(options["asset"], **thresholds)
        asset = self.field.asset
        self.proxy = make_proxy(options.get("proxy", "box"), asset.half_extents)
        self.sampling = options.get("sampling", "emission")
        scene_from_proxy = options.get("to_world", np.eye(4)) @ asset.world_from_proxy
        self.scale = mi.Float(similarity_scale(scene_from_proxy, "to_world"))
        self.to_scene = mi.Transform4f(scene_from_proxy)
        self.to_local = mi.Transform4f(np.linalg.inv(scene_from_proxy))
        # Opaque: moving a luminaire does not compile new kernels.
        dr.make_opaque(self.to_scene, self.to_local, self.scale)

    def local_line(self, point: Any, direction: Any) -> tuple[Any, Any]:
        """Point and unit direction of travel of a scene line in the local frame."""
        import drjit as dr

        return self.to_local @ point, dr.normalize(self.to_local @ direction)


def _plugin_classes(mi: Any) -> tuple[type, type]:
    """Emitter and BSDF classes for the current variant, whose base classes they extend."""
    import drjit as dr

    from lumitree.render.sampling import EmitterSampler

    class LumitreeEmitter(mi.Emitter):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            placed = self.placed = Placed(props)
            boxes = placed.field.light_boxes if placed.sampling == "emission" else None
            half_extents = placed.field.asset.half_extents
            self.sampler = EmitterSampler(placed.proxy, half_extents, boxes)
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def eval(self, si, active=True):
            return self.eval_through(si, active)[0]

        def eval_through(self, si, active):
            """Radiance and transmittance in one traversal, for `lumitree_path`."""
            line = self.placed.local_line(si.p, -si.to_world(si.wi))
            entering = active & (mi.Frame3f.cos_theta(si.wi) > 0)
            radiance, through = self.placed.field.emission(*line, entering)
            return radiance & entering, dr.select(entering, through, 1)

        def sample_direction(self, it, sample, active=True):
            ds, weight = self.aim(it, sample, active)
            return ds, weight * self.eval_direction(it, ds, active & (ds.pdf > 0))

        def aim(self, it, sample, active):
            """As `sample_direction`, but the weight lacks the radiance, which costs a traversal."""
            placed = self.placed
            origin = placed.to_local @ it.p
            direction, pdf = self.sampler.sample(origin, sample, active)
            active = active & (pdf > 0)
            distance, n, _ = placed.proxy.enter(origin, direction)
            ds = dr.zeros(mi.DirectionSample3f)
            ds.p = placed.to_scene @ mi.Point3f(origin + distance * direction)
            ds.n = dr.normalize(placed.to_scene @ mi.Vector3f(n))
            ds.d = ds.p - it.p
            ds.dist = dr.norm(ds.d)
            ds.d /= ds.dist
            ds.time = it.time
            ds.pdf = dr.select(active, pdf, 0)
            ds.delta = False
            ds.emitter = mi.EmitterPtr(self)
            return ds, mi.Color3f(dr.rcp(pdf)) & active

        def pdf_direction(self, it, ds, active=True):
            line = self.placed.local_line(it.p, ds.d)
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            return dr.select(facing, self.sampler.pdf(*line, facing), 0)

        def eval_direction(self, it, ds, active=True):
            line = self.placed.local_line(it.p, ds.d)
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            radiance, _ = self.placed.field.emission(*line, facing)
            return radiance & facing

        def sample_wavelengths(self, si, sample, active=True):
            return mi.Color0f(), self.eval(si, active)

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            placed = self.placed
            p, direction, pdf = self.sampler.sample_line(sample1, sample2, sample3, active)
            radiance, _ = placed.field.emission(p, -direction, active)
            # Where the line leaves the proxy is where its reverse enters.
            distance, n, _ = placed.proxy.enter(p, -direction)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.p = placed.to_scene @ mi.Point3f(p - distance * direction)
            si.n = dr.normalize(placed.to_scene @ mi.Vector3f(n))
            si.time = time
            ray = si.spawn_ray(dr.normalize(placed.to_scene @ direction))
            return ray, (radiance * dr.square(placed.scale) / pdf) & active

        def sample_position(self, time, sample, active=True):
            raise LumitreeError(
                "the 'lumitree' emitter cannot be connected to a camera; set hide_emitters of the "
                "integrator that traces from the light"
            )

        def to_string(self) -> str:
            return f"LumitreeEmitter[luminaire={self.placed.field.asset.luminaire}]"

    class LumitreeNull(mi.BSDF):
        def __init__(self, props: Any) -> None:
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

        def eval(self, ctx, si, wo, active=True):
            return mi.Color3f(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return mi.Color3f(0), mi.Float(0)

        def eval_null_transmission(self, si, active=True):
            line = self.placed.local_line(si.p, -si.to_world(si.wi))
            entering = active & (mi.Frame3f.cos_theta(si.wi) > 0)
            through = self.placed.field.transmittance(*line, entering)
            return mi.Color3f(dr.select(entering, through, 1))

        def to_string(self) -> str:
            return f"LumitreeNull[luminaire={self.placed.field.asset.luminaire}]"

    return LumitreeEmitter, LumitreeNull
