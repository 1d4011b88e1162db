"""The plugins of Mitsuba: emitter, BSDF, shape, and the integrator."""
