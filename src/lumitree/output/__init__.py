"""What is looked at elsewhere: sheets, the viewer, lamps for Blender."""
