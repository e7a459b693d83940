"""Turn results into tables, figures and documents (`write`); the only package that draws."""
