"""The needle in a scan: `segmentation` > `centerline` > `axis`, `sections`, `tip`."""
