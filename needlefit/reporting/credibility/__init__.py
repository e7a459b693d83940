"""Credibility evidence of a run in one document, ordered as ASME V&V 40-2018; gaps are shown empty."""
