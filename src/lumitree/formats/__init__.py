"""Photometric files and ray files, read and written.

`photometric_file` chooses the reader. IES and EULUMDAT files (`ies`, `ldt`) hold a
`type_c.IntensityDistribution` with a luminous opening (`opening`), ray files (`tm25`) hold
`rays.Rays`, and `tm33` reads IES TM-33. GLDF files are read by `gldf`, `l3d` and `gldf_asset`, over
`archive` and `xml_tree`, which read bounded amounts. `light_field` makes assets of all of them,
with bins that are fitted to the renderer's interpolation; `light_sources` adds several openings to
one.
"""
