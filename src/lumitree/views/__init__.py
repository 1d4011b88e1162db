"""Views of a luminaire: radiance and opacity, rendered by Mitsuba."""
