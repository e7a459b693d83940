"""A scan that is looked at and corrected by hand before it is reconstructed."""
