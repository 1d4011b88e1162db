"""Web pages without a network or other files: of an asset, and of an image with dimmers.

`mix` changes the light of an image, and `dimmers` makes its page: layers, compressed by what they
share, which shaders sum and show as the photographs of `rendering`.

`packing` converts an asset into arrays for textures, and `view` puts them into one file with the
scripts and shaders of the folder `page/`: one shader follows paths through the geometry, one
traverses the field as `octree` does, and one sums the illuminance of the walls of a box over the
cells of the light field. `model` traces the surfaces, and `triangles` removes the noise of the
paths. `light_as_field` makes a field of an asset that has a light field only, and `polar`
draws the polar curve of a page.
"""
