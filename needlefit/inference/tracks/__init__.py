"""Inference from tip tracks: one simulated insertion gives the tip at every depth that it passed."""
