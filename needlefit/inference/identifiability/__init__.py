"""What the data determine: Fisher information, profile likelihoods, and whether they agree."""
