"""Baking from rays of the path tracer: estimation and refinement, with no pictures and no network."""
