"""A lamp in a diffuse room, rendered by Cycles and by Mitsuba."""
