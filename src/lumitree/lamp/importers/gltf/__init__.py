"""Lamps from glTF 2.0 files (`.gltf`, `.glb`)."""

from lumitree.lamp.importers.gltf.reader import read_gltf

__all__ = ["read_gltf"]
