"""Measured insertions and tip tracks: how they are read, checked, written and selected."""
