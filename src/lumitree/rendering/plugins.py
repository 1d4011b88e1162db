"""The Mitsuba plugins: emitter `lumitree`, BSDF `lumitree_null` and shape `lumitree_proxy`.

(The integrator `lumitree_path` is registered here too.) All take the same properties:

    filename      the asset
    to_world      where the luminaire goes, relative to its own file's frame (default: there)
    proxy         "box" (default) or "sphere"
    min_density, max_opacity    see `lumitree.rendering.field.Field`; exact by default
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
    shape = importlib.import_module("lumitree.rendering.shape")
    integrator = importlib.import_module("lumitree.rendering.integrator").integrator_class()
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

        from lumitree.rendering.field import open_field
        from lumitree.rendering.proxy import make_proxy

        options = _options(props)
        thresholds = {n: options[n] for n in ("min_density", "max_opacity") if n in options}
        self.field = open_field(options["asset"], **thresholds)
        asset = self.field.asset
        self.proxy = make_proxy(options.get("proxy", "box"), asset.half_extents)
        self.sampling = options.get("sampling", "emission")
        scene_from_proxy = options.get("to_world", np.eye(4)) @ asset.world_from_proxy
        scale = similarity_scale(scene_from_proxy, "to_world")
        self.scale = mi.Float(scale)
        self._centre = mi.Point3f(scene_from_proxy[:3, 3])
        self._rotation = mi.Matrix3f(scene_from_proxy[:3, :3] / scale)
        # Opaque: moving a luminaire does not compile new kernels.
        dr.make_opaque(self.scale, self._centre, self._rotation)

    def entering_line(self, si: Any, active: Any) -> tuple[Any, Any]:
        """Local line of what looks at an interaction with the proxy, and where it enters there."""
        import mitsuba as mi

        line = self.local_line(si.p, -si.to_world(si.wi))
        return line, active & (mi.Frame3f.cos_theta(si.wi) > 0)

    def local_line(self, point: Any, direction: Any) -> tuple[Any, Any]:
        """A point of a scene line and its unit direction of travel, in the local frame."""
        return self.local_point(point), self.local_direction(direction)

    def local_point(self, point: Any) -> Any:
        """A scene point (mi.Point3f) in the local frame."""
        import mitsuba as mi

        # The centre first: the difference of two points near each other is exact, however far from
        # the origin they are. A matrix with a translation adds rounded products that cancel.
        return mi.Point3f(self._rotation.T @ (point - self._centre) / self.scale)

    def local_direction(self, direction: Any) -> Any:
        """A direction of the scene in the local frame, unit length."""
        import drjit as dr

        return dr.normalize(self._rotation.T @ direction)

    def scene_point(self, point: Any) -> Any:
        """A point of the local frame in the scene (mi.Point3f)."""
        import mitsuba as mi

        return self._centre + mi.Point3f(self.scale * (self._rotation @ point))

    def scene_direction(self, direction: Any) -> Any:
        """A direction of the local frame in the scene (mi.Vector3f), unit length."""
        import drjit as dr
        import mitsuba as mi

        return mi.Vector3f(dr.normalize(self._rotation @ direction))


def _plugin_classes(mi: Any) -> tuple[type, type]:
    """Emitter and BSDF classes for the current variant, whose base classes they extend."""
    import drjit as dr

    from lumitree.rendering.emitter_sampling import EmitterSampler

    class LumitreeEmitter(mi.Emitter):
        def __init__(self, props: Any) -> None:
            super().__init__(props)
            placed = self.placed = Placed(props)
            leaves = placed.field.light_leaves if placed.sampling == "emission" else None
            self.sampler = EmitterSampler(placed.proxy, placed.field, leaves)
            self.m_flags = mi.EmitterFlags.Surface | mi.EmitterFlags.SpatiallyVarying

        def eval(self, si, active=True):
            line, entering = self.placed.entering_line(si, active)
            return self.placed.field.emission(*line, entering)[0] & entering

        def eval_through(self, si, it, active):
            """Radiance, T, and the density of `sample_direction` from `it`, in one traversal."""
            line, entering = self.placed.entering_line(si, active)
            distance = dr.norm(si.p - it.p) / self.placed.scale
            radiance, through, pdf = self.sampler.look(*line, distance, entering)
            return radiance & entering, dr.select(entering, through, 1), pdf

        def sample_direction(self, it, sample, active=True):
            ds, reach = self.aim(it, sample, active)
            weight, ds.pdf = self.look(it, ds, reach, active & (ds.pdf > 0))
            return ds, weight

        def aim(self, it, sample, active):
            """Direction of `sample_direction`, and how far it reaches; its density is for `look`.

            So a shadow ray can be traced before the luminaire is, which costs more.
            """
            placed = self.placed
            origin = placed.local_point(it.p)
            direction, reach = self.sampler.aim(origin, sample, active)
            distance, n, enters = placed.proxy.enter(origin, direction)
            ds = dr.zeros(mi.DirectionSample3f)
            ds.p = placed.scene_point(origin + distance * direction)
            ds.n = placed.scene_direction(n)
            # Not from the difference of both points: far from the origin they are rounded.
            ds.d = placed.scene_direction(direction)
            ds.dist = distance * placed.scale
            ds.time = it.time
            ds.pdf = dr.select(active & enters, 1, 0)
            ds.delta = False
            ds.emitter = mi.EmitterPtr(self)
            return ds, reach

        def look(self, it, ds, reach, active):
            """Radiance over density, and density, of a direction that `aim` gave."""
            x, direction = self.placed.local_line(it.p, ds.d)
            distance = ds.dist / self.placed.scale
            entry = x + distance * direction
            radiance, _, pdf = self.sampler.look(entry, direction, distance, active, reach)
            return dr.select(pdf > 0, radiance / pdf, 0), pdf

        def pdf_direction(self, it, ds, active=True):
            entry, direction = self.placed.local_line(ds.p, ds.d)
            distance = dr.norm(ds.p - it.p) / self.placed.scale
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            return self.sampler.pdf(entry, direction, distance, facing)

        def eval_direction(self, it, ds, active=True):
            line = self.placed.local_line(it.p, ds.d)
            facing = active & (dr.dot(ds.d, ds.n) < 0)
            radiance, _ = self.placed.field.emission(*line, facing)
            return radiance & facing

        def sample_wavelengths(self, si, sample, active=True):
            return mi.Color0f(), self.eval(si, active)

        def sample_ray(self, time, sample1, sample2, sample3, active=True):
            placed = self.placed
            p, direction, radiance, pdf = self.sampler.sample_line(
                sample1, sample2, sample3, active
            )
            # Where the line leaves the proxy is where its reverse enters.
            distance, n, _ = placed.proxy.enter(p, -direction)
            si = dr.zeros(mi.SurfaceInteraction3f)
            si.p = placed.scene_point(p - distance * direction)
            si.n = placed.scene_direction(n)
            si.time = time
            ray = si.spawn_ray(placed.scene_direction(direction))
            weight = radiance * dr.square(placed.scale) / pdf
            return ray, weight & (active & (pdf > 0))

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
            line, entering = self.placed.entering_line(si, active)
            through = self.placed.field.transmittance(*line, entering)
            return mi.Color3f(dr.select(entering, through, 1))

        def to_string(self) -> str:
            return f"LumitreeNull[luminaire={self.placed.field.asset.luminaire}]"

    return LumitreeEmitter, LumitreeNull
