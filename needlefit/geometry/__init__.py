"""Frames, curves, surfaces, their crossings, and the comparison of two curves; knows no needle and no file layout."""
