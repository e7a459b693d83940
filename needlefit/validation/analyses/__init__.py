"""Kinds of study other than fit and score: one module or package each."""
