"""Guided import: files of other programs become a dataset, and every guess is recorded in it."""
