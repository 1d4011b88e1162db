"""Rays and paths through a luminaire."""
