"""The same rooms and photometric files in Radiance and in Mitsuba."""
