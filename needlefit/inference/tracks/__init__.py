"""Inference from tracked tips: one simulated insertion gives the tip at every depth it passed."""
