"""A file of placements with all keys."""

PLACEMENTS = """[lamps.kitchen]
asset = "a.lumitree"
at = [0, 2.5, -1]
size = 0.4
rotate = [0, 1, 0, 45]
gain = [1, 0.5, 0.25]
lumens = 800
temperature = 2700.0
[lamps."desk lamp"]
asset = "bulbs"
gain = 1
"""
