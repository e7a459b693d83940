"""DICOM series: `header` (one file), `series` (which one), `stack` (what is wrong with it), read, write."""
