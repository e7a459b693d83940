"""Kinds of study other than "tune on these, score on those": one module or package each."""
