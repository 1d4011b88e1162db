"""Assets for other renderers: a lamp as Blender has it, point lights and meshes."""
