"""The light field of a lamp, from light paths.

`grid` chooses the side of its cells. `bake` makes it, a histogram that states what it was estimated
from (`TracedPaths`). `inside` makes the light inside the lamp's box of the light that ends on the
luminaire, and `codebook` stores curves over distance by their number.
"""
