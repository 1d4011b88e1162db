"""Baking from traced rays: estimation and refinement, with no pictures and no network."""
