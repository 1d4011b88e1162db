"""Rays and paths through a lamp: light paths, cameras, views, histograms of light."""
