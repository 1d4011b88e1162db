"""Lamps for other programs: one module for each, and `export` with the public function.

They share `point_lights`, which clusters a light field, `light_profiles`, their IES profiles and
Blender's spots, `pbr`, which converts materials to metalness and roughness, and `surfaces`, meshes
with these materials. Outputs of several files are written into a temporary folder beside the
output (`core.files.atomic_files`).
"""
