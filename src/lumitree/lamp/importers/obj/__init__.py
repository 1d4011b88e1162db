"""Wavefront OBJ models with MTL materials.

The formats are those of "Object Files (.obj)" and "Material Library File
(.mtl)", Wavefront Technologies, 1995; the physically based MTL keys (Pr, Pm, Ps, Pc, Pcr, aniso,
norm) are those that Exocortex proposed.
"""
