"""Measured insertions and tip tracks: read, check, write and select them."""
