"""The mechanical model: needle, tissue and controls, the model twice (`reference`, `kernel`), and `simulate`.

Knows no data and no files; docs/model.md states the equations.
"""
