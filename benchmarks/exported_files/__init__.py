"""Readers of exported lamps, independent of their writers; and their lights, summed."""
