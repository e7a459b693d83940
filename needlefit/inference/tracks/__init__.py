"""Infer parameters from tip tracks: one simulated insertion gives the tip at every depth on its path."""
