"""Base class of BSDFs that light leaves in single directions only."""

import mitsuba as mi


def delta_bsdf_class() -> type:
    """Base class for the variant of Mitsuba that is set: a BSDF that is 0 for given directions."""

    class DeltaBSDF(mi.BSDF):
        def eval(self, ctx, si, wo, active=True):
            return mi.Spectrum(0)

        def pdf(self, ctx, si, wo, active=True):
            return mi.Float(0)

        def eval_pdf(self, ctx, si, wo, active=True):
            return mi.Spectrum(0), mi.Float(0)

    return DeltaBSDF
