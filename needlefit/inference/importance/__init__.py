"""Approximate a posterior by importance sampling: weighted draws about the modes of a fit."""
