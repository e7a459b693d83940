"""Checked plain records of the text files that a user writes: one kind of file, one module."""
