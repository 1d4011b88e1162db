"""Photometric files and ray files, read and written."""
