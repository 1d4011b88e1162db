"""Luminous intensity by direction: measurement, photometric files, ray files, reports."""
