"""Assets in Mitsuba scenes: placement, images, passes."""
