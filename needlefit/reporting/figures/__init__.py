"""Figures, one file each, drawn in the same way on every machine (`style`)."""
