"""Sampling of the light that an asset sends to a receiver."""
