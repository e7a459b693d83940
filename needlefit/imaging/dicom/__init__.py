"""Read DICOM series: `header` (a file), `stack` (slices to a checked grid), `series` (find, read, write).

Segmentations: `segmentation` (SEG), `contours` (RTSTRUCT), `segmentation_writer`.
"""
