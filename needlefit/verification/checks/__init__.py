"""The checks of the verification: one family per file, all files of this folder are found.

A file defines `CHECKS`, a tuple of `Check`; adding a file adds its rows to the table.
"""
