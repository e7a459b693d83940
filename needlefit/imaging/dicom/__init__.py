"""Read DICOM: `stack` (slices to a checked grid), `series` (find, read), `contours` (RTSTRUCT)."""
