"""Functions that `dr.dispatch` calls with each emitter, be it a `DeferredEmitter` or not.

`LampKinds.call` calls those of the integrator, also with a `LampLight` in place of an emitter, and
with None where a result is of no use.
"""

from __future__ import annotations

import drjit as dr
import mitsuba as mi

from lumitree.rendering.plugins.deferred_emitter import DeferredEmitter, EmitterSample
from lumitree.rendering.plugins.geometry_plugins import GeometryEmitter
from lumitree.rendering.plugins.lamp_light import LampLight
from lumitree.rendering.sampling.emitter_sampling import Target


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
