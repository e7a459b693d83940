"""Reconstruct the needle's centreline, mm, from a CT scan.

Only this package imports SimpleITK, pydicom and skimage.
"""
