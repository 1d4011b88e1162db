"""glTF 2.0: meshes, materials, and lights with IES profiles."""
