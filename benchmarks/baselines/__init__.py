"""Other representations of the light of a luminaire.

Those of `fitting` are fitted to the rays that lumitree's light field is made of. Except the
ray set and the wavelets, all of them are sets of sources, each with a place and a radiant intensity
by direction (`sources.Sources`). They differ in what a source is: a point, a disk, a patch of the
bounding box, or a cell inside it. `wavelets` compresses a 4D light field on the box. `light_flow`
fits a normalizing flow to the same rays. `zhu` has networks that are trained on the views that the
paper's network is trained on.
"""
