"""Measured insertions: the nouns (`insertion`), and how they are read, checked, written and selected."""
