"""Wavefront OBJ models with MTL materials.

The formats as their maker described them: "Object Files (.obj)" and "Material Library File
(.mtl)", Wavefront Technologies, 1995; the physically based MTL keys (Pr, Pm, Ps, Pc, Pcr, aniso,
norm) as Exocortex proposed them.
"""
