"""DICOM: `stack` (slices to a checked grid), `series` (find, read), `write`, `contours` (RTSTRUCT)."""
