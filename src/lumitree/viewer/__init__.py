"""The viewer: one web page that shows an asset, without a network or other files.

`packing` converts an asset into arrays for textures, `page` puts them into one file with those of
the folder `page/`: a shader that follows paths through the geometry, one that traverses the field
as `octree.traversal` does, and one that sums the illuminance of the walls of a box over the cells
of the light field. `model` traces the surfaces, and `smoothing` removes the noise of the paths.
`light_as_field` makes a field of an asset that has a light field alone.
"""
