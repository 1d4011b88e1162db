"""Geometry files (OBJ, glTF) and overrides of their materials: to a `Geometry`."""
