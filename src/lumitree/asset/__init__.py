"""Baked luminaires as data: the octree and its file format."""
