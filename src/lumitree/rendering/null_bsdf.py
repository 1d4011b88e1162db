"""The BSDF `lumitree_null`: objects behind a baked luminaire stay visible."""

from __future__ import annotations

import contextlib
from collections.abc import Iterator
from contextvars import ContextVar

import drjit as dr
import mitsuba as mi

from lumitree.rendering.emitter import PlacedAsset
from lumitree.rendering.geometry import delta_bsdf_class

_WITHOUT_PROXIES: ContextVar[bool] = ContextVar("_WITHOUT_PROXIES", default=False)


@contextlib.contextmanager
def without_proxies() -> Iterator[None]:
    """Context in which no ray meets a proxy as a shape, so that no code is recorded for that.

    Dr.Jit records the BSDFs of all scenes in the process; the field of each lamp would take long.
    """
    token = _WITHOUT_PROXIES.set(True)
    try:
        yield
    finally:
        _WITHOUT_PROXIES.reset(token)


def null_bsdf_class() -> type:
    """Class of the BSDF for the variant of Mitsuba that is set, whose base class it extends.

    Light crosses it unbent, with the transmittance of the whole line through the proxy on the face
    where the line enters, and 1 on the face where it leaves. Where the geometry is shown, its
    shapes attenuate light, and the transmittance is 1.
    """

    class LumitreeNull(delta_bsdf_class()):
        def __init__(self, props: mi.Properties) -> None:
            super().__init__(props)
            self.placed = PlacedAsset(props)
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
            if not self.placed.attenuates or _WITHOUT_PROXIES.get():
                return mi.Spectrum(1) & active
            line, entering = self.placed.entering_line(si, active)
            through = self.placed.field.transmittance(*line, entering)
            return mi.Spectrum(dr.select(entering, through, 1))

        def to_string(self) -> str:
            return f"LumitreeNull[luminaire={self.placed.asset.luminaire}]"

    return LumitreeNull
