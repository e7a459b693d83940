"""The model of `mechanics/reference.py`, compiled; a test ties the two."""
