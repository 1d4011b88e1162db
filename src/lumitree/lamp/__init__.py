"""The lamp as it is given: files, built-in lamps and Mitsuba scenes, read and checked."""
