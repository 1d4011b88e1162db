"""The light field of a lamp, from light paths.

`bake` chooses the side of the cells and makes a histogram that states what it was estimated from
(`TracedPaths`). `inside` makes the light inside the lamp's box of the light that ends on the
luminaire, and stores curves over distance by their number.
"""
