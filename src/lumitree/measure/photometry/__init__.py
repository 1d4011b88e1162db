"""Luminous intensity by direction: measurement, figures, reports."""
