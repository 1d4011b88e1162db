"""Model files (OBJ, glTF) and overrides of their materials: to a `Model`."""
