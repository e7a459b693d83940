"""Estimate parameters from a dataset and a model, and state what the data determine."""
