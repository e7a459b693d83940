"""Frames, curves, surfaces, crossings, comparison of two curves; knows no needle and no file layout."""
