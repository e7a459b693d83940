"""Determine which parameters the data identify: Fisher information, profile likelihoods, their agreement."""
