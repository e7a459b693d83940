"""Read DICOM series: `header` (one file), `stack` (slices to a grid, with checks), `series` (find, read,
write).
"""
