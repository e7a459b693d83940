"""Radiopaque balls in a scan: `blobs` finds what has their size, `fit` places them."""
