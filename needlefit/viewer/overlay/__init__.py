"""What lies over the needle: a measured one with its errors, the band of a fit, the slice of a scan."""
