"""Conventions, mathematics and files that every other package builds on."""
