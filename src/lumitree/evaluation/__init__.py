"""Metrics and contact sheets of baked luminaires on held-out views."""
