"""Many lamps, baked into one folder with an index page."""
