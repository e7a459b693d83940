"""From a CT scan to the needle's centreline in mm. Only this package imports SimpleITK, pydicom and
skimage.
"""
