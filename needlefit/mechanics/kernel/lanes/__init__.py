"""Many parameter sets of one insertion at once: `insertion` > `newton` > `tables` > `passes`."""
