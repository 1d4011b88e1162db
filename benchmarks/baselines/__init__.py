"""Other representations of the light of a luminaire, fitted to the same rays as lumitree's.

All of them are sets of sources, each with a place and a radiant intensity by direction
(`sources.Sources`), except the ray set. They differ in what a source is: a point, a disk, a patch of
the bounding box, or a cell inside it.
"""
