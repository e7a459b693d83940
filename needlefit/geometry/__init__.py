"""Frames, curves, surfaces, meshes, crossings, comparison of two curves; knows no needle and no file
layout.
"""
