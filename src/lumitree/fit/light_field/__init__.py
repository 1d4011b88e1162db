"""The light field of a lamp, from light paths."""
