"""From a scan to points in millimetres: one arrow a file; the only home of SimpleITK, pydicom and skimage."""
