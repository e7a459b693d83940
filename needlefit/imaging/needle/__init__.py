"""The needle in a scan: `segmentation` > `centerline` > `spine`, `sections`, `tip`."""
