"""Lamps for Blender: a script, point lights and meshes."""
