"""A lamp as meshes, materials and media: what importers and built-in lamps make."""
