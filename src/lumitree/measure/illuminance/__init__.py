"""Illuminance of planes, surfaces and points of a scene.

What a lamp sends straight is a sum over the cells of its light field, which is the control variate
of emitter sampling with shadows (`estimate`); what surfaces reflect is traced.
"""
