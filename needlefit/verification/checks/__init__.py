"""The checks: one family, one file, found by its folder.

A file defines `CHECKS`, a tuple of `Check`; adding a file adds its rows to the table.
"""
