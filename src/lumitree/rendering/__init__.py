"""Mitsuba plugins that render a baked luminaire."""
