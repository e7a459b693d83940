"""A posterior known by weighted draws, where nothing was sampled."""
