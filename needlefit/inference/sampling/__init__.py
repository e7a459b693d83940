"""Sample a posterior: by importance about its modes, and by ensembles of walkers, until they converge."""
