"""Collect the credibility evidence of a run in one document, ordered as in ASME V&V 40-2018; gaps
are shown.
"""
