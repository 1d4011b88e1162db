"""Luminaires as Mitsuba scenes: built-in lamps and scene files."""
