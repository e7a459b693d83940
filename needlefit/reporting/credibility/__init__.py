"""One document of what speaks for a model's credibility, ordered as ASME V&V 40-2018, gaps left empty."""
