"""Cone-beam CT volumes of a needle in a phantom: what the scanner would have seen of a known truth."""
