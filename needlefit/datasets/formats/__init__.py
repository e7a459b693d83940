"""File formats, one module each: they read cells with line numbers, or points; insertions are
unknown here.
"""
