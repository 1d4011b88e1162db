"""Figures of lamps and assets: errors, irradiance, photometry."""
