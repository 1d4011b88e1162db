"""Illuminance of planes, surfaces and points of a scene."""
