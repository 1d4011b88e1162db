"""Output for other programs and for people: previews, the viewer, exported lamps.

`targets` has one module for each program. They share `point_lights`, which clusters a light field,
`ies_profiles`, profiles of lights, `spots`, lights for Blender's importers, and `pbr`, which
converts materials to metalness and roughness.
Outputs of several files are written into a temporary folder beside the output
(`core.files.atomic_files`).
"""
