"""The synthetic data set: 47 insertions whose truth is known; the model that is fitted to them is another."""
