"""Find the needle in a scan: `segmentation`, then `centerline` with `axis_spline`, then `tip`."""
