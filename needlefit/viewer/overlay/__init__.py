"""Overlays of the simulated needle: a measured needle, the band of a fit, a slice of a scan."""
