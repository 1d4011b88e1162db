"""Fits of an asset to traced light: the octree, the light field, the network."""
