"""Photometric files and ray files, read and written, and assets made of them.

`photometric_file` chooses the reader. IES and EULUMDAT files (`ies`, `ldt`) and IES TM-33 (`tm33`)
have a `type_c.IntensityDistribution` with a luminous opening (`opening`), ray files (`tm25`) have
rays. `gldf` reads products, with 3D models of `l3d`. `reading` reads text, XML and archives within
limits. `light_field` makes assets, with bins that are fitted to the renderer's interpolation;
`light_sources` adds several openings to one.
"""
