"""Other representations of the light of a luminaire, fitted to the same rays as lumitree's.

Except the ray set, all of them are sets of sources, each with a place and a radiant intensity by
direction (`sources.Sources`). They differ in what a source is: a point, a disk, a patch of the
bounding box, or a cell inside it.
"""
