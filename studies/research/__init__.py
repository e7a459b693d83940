"""What scripts of `studies/` share: simulated needles, and quick fits. It uses names that are not public."""
