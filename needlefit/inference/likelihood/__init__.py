"""Compute the likelihood of measured centrelines, marginalised over noise, pose and layer depths.

Equations: docs/inference.md.
"""
