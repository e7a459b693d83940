"""Turn results into tables, figures, documents and pages; the only package that draws."""
