"""DICOM series: `header` (one file), `stack` (slices to a grid, and its checks), `series` (find, read,
write).
"""
