"""Ways to render a lamp in a room, by Mitsuba, LuxCore and Cycles, and their figures."""
