"""Importance sampling: a posterior as weighted draws about the modes of a fit."""
