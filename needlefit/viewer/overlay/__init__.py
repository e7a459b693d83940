"""Overlays of the simulated needle: a measured needle, the band of a fit, the slice of a scan."""
