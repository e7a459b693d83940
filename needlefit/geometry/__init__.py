"""Geometry without needles or files: frames, curves, surfaces, meshes, crossings, comparison of curves."""
