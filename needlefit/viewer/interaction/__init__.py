"""The inputs of a user, and the needle that they control."""
