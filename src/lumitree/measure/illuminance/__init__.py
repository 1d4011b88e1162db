"""Illuminance of planes, surfaces and points of a scene.

Direct light from the light field of a lamp is a sum over cells, the control variate of emitter
sampling with shadows (`estimate`). Straight light of a lamp with geometry is sampled, and what
surfaces reflect is traced.
"""
